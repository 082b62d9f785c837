#include "odmc/io/options_yaml.h"

#include "odmc/io/yaml_text.h"
#include "odmc/text/number_text.h"
#include "text_file.h"
#include "yaml_reader.h"

namespace odmc::internal {

struct OptionsYamlReader::Impl {
  /// The key's value, if the file has it.
  std::optional<YamlValue> Take(const std::string& key) {
    known.push_back(key);
    return root ? root->Find(key) : std::nullopt;
  }

  std::optional<YamlValue> root;  // none where the file is empty: every default holds
  std::vector<std::string> known;
};

OptionsYamlReader::OptionsYamlReader(const std::string& file) : impl_(std::make_unique<Impl>()) {
  const std::string text = ReadText(file);
  bool empty = true;
  try {
    empty = YAML::Load(text).IsNull();  // nothing or only comments
  } catch (const YAML::Exception&) {
    empty = false;  // Parse() says what is wrong
  }
  if (!empty) impl_->root = YamlValue::Parse(text, file);
}

OptionsYamlReader::~OptionsYamlReader() = default;

void OptionsYamlReader::Field(const std::string& key, double* value) {
  if (const auto entry = impl_->Take(key)) *value = entry->Number();
}

void OptionsYamlReader::Field(const std::string& key, int* value) {
  if (const auto entry = impl_->Take(key)) *value = entry->Integer();
}

void OptionsYamlReader::Field(const std::string& key, bool* value) {
  if (const auto entry = impl_->Take(key)) *value = entry->Bool();
}

void OptionsYamlReader::Field(const std::string& key, std::string* value) {
  if (const auto entry = impl_->Take(key)) *value = entry->Text();
}

void OptionsYamlReader::Field(const std::string& key, Eigen::Vector3d* value) {
  if (const auto entry = impl_->Take(key)) *value = entry->Vector3();
}

void OptionsYamlReader::CheckAllRead() const {
  if (impl_->root) impl_->root->AllowKeys(impl_->known);
}

void OptionsYamlPrinter::Field(const std::string& key, const double* value) {
  text_ += key + ": " + FormatYamlNumber(*value) + "\n";
}

void OptionsYamlPrinter::Field(const std::string& key, const int* value) {
  text_ += key + ": " + std::to_string(*value) + "\n";
}

void OptionsYamlPrinter::Field(const std::string& key, const bool* value) {
  text_ += key + ": " + (*value ? "true" : "false") + "\n";
}

void OptionsYamlPrinter::Field(const std::string& key, const std::string* value) {
  text_ += key + ": \"" + *value + "\"\n";
}

void OptionsYamlPrinter::Field(const std::string& key, const Eigen::Vector3d* value) {
  text_ += key + ": " + YamlList(*value) + "\n";
}

}  // namespace odmc::internal
