#include "odmc/io/vehicle_writer.h"

#include <cmath>
#include <cstdlib>

#include "odmc/io/yaml_text.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"

namespace odmc {
namespace {

constexpr size_t kColumns = 100;

/// To six digits; what is below a nanometre is zero.
double SixDigits(double value) {
  const double rounded = std::strtod(Format("%.6g", value).c_str(), nullptr);
  return std::abs(rounded) < 1e-12 ? 0.0 : rounded;
}

std::string NumberText(double value) { return FormatYamlNumber(SixDigits(value)); }

std::string ListText(const Eigen::Vector3d& v) { return YamlList(v.unaryExpr(&SixDigits)); }

std::string MountText(SensorMount mount) {
  mount.p_BS = mount.p_BS.unaryExpr(&SixDigits).eval();
  mount.q_BS.coeffs() = mount.q_BS.coeffs().unaryExpr(&SixDigits).eval();
  return YamlMount(mount);
}

/// Broken at blanks, every line after `indent` and "# ".
std::string Comment(const std::string& text, const std::string& indent) {
  std::string lines, line;
  const std::string printable = Printable(text);
  for (size_t at = 0; at < printable.size();) {
    size_t end = printable.find(' ', at);
    if (end == std::string::npos) end = printable.size();
    const std::string word = printable.substr(at, end - at);
    if (!line.empty() && indent.size() + 3 + line.size() + word.size() > kColumns) {
      lines += indent + "# " + line + "\n";
      line.clear();
    }
    line += (line.empty() ? "" : " ") + word;
    at = end + 1;
  }
  return lines + (line.empty() ? "" : indent + "# " + line + "\n");
}

class Writer {
 public:
  explicit Writer(const VehicleComments& comments) : comments_(comments) {}

  void Line(const std::string& key, const std::string& value, const std::string& indent = "") {
    const auto comment = comments_.key.find(key);
    if (comment != comments_.key.end()) text_ += Comment(comment->second, indent);
    text_ += indent + key + ":" + (value.empty() ? "" : " ") + value + "\n";
  }

  void Head() {
    for (const std::string& paragraph : comments_.head) {
      text_ += (text_.empty() ? "" : "#\n") + Comment(paragraph, "");
    }
    if (!text_.empty()) text_ += "\n";
  }

  void Rotors(const std::vector<Rotor>& rotors) {
    Line("rotors", "");
    for (size_t j = 0; j < rotors.size(); ++j) {
      text_ += "  - {position_m: " + ListText(rotors[j].p_BP) +
               ", spin: " + (rotors[j].spin > 0.0 ? "cw" : "ccw") +
               ", radius_m: " + NumberText(rotors[j].radius_m) + "}";
      if (j < comments_.rotor.size()) text_ += "  # " + Printable(comments_.rotor[j]);
      text_ += "\n";
    }
  }

  void Effects(const std::vector<std::string>& effects) {
    Line("effects", "[" + Listed(effects) + "]");
  }

  void Parameters(const std::map<std::string, ParameterSetting>& parameters) {
    if (parameters.empty()) return;
    Line("parameters", "");
    for (const auto& [name, setting] : parameters) {
      std::vector<std::string> entries;
      const auto add = [&entries](const std::string& key, const std::string& value) {
        entries.push_back(key + ": " + value);
      };
      if (setting.value) add("value", NumberText(*setting.value));
      if (setting.sigma) add("sigma", NumberText(*setting.sigma));
      if (setting.estimated) add("state", *setting.estimated ? "estimated" : "frozen");
      Line(name, "{" + Listed(entries) + "}", "  ");
    }
  }

  const std::string& text() const { return text_; }

 private:
  const VehicleComments& comments_;
  std::string text_;
};

}  // namespace

std::string VehicleText(const Vehicle& vehicle, const VehicleComments& comments) {
  Writer writer(comments);
  writer.Head();
  writer.Line("name", YamlQuoted(Printable(vehicle.name, 80)));
  writer.Line("mass_kg", NumberText(vehicle.mass_kg));
  writer.Line("gravity_m_s2", NumberText(vehicle.gravity_m_s2));
  writer.Line("inertia_kg_m2", ListText(vehicle.inertia_kg_m2));
  writer.Rotors(vehicle.rotors);
  writer.Line("odometry", MountText(vehicle.odometry));
  if (vehicle.imu) writer.Line("imu", MountText(*vehicle.imu));
  writer.Effects(vehicle.effects);
  writer.Parameters(vehicle.parameters);
  return writer.text();
}

}  // namespace odmc
