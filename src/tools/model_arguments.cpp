#include "model_arguments.h"

#include <cmath>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "odmc/effects/effects.h"
#include "odmc/io/options_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/refusal.h"
#include "tool_support.h"

namespace odmc::tools {
namespace {

/// Visitor that sets one field from text.
class OptionSetter {
 public:
  OptionSetter(std::string key, std::string text) : key_(std::move(key)), text_(std::move(text)) {}

  void Field(const std::string& key, double* value) {
    if (Takes(key) && !ParseNumber(text_, value)) Refuse("a number");
  }
  void Field(const std::string& key, int* value) {
    if (!Takes(key)) return;
    double number = 0.0;
    if (!ParseNumber(text_, &number) || !(std::abs(number) < 1e9) || number != std::round(number)) {
      Refuse("an integer");
    }
    *value = static_cast<int>(number);
  }
  void Field(const std::string& key, bool* value) {
    if (!Takes(key)) return;
    if (text_ != "true" && text_ != "false") Refuse("true or false");
    *value = text_ == "true";
  }
  void Field(const std::string& key, std::string* value) {
    if (Takes(key)) *value = text_;
  }

  bool found() const { return found_; }

 private:
  bool Takes(const std::string& key) {
    found_ = found_ || key == key_;
    return key == key_;
  }
  [[noreturn]] void Refuse(const std::string& wanted) const {
    throw UsageError("--set " + key_ + ": expected " + wanted + ", not '" + text_ + "'");
  }

  std::string key_, text_;
  bool found_ = false;
};

/// Effects, and their parameters' full names.
std::vector<std::string> EffectAndParameterNames() {
  const Vehicle vehicle = NominalVehicle();
  const std::vector<std::string>& effects = EffectRegistry::Default().names();
  std::vector<std::string> names = effects;
  for (const std::string& name : effects) {
    const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(name, vehicle);
    for (const ParameterSpec& spec : effect->parameters()) names.push_back(name + "." + spec.name);
  }
  return names;
}

}  // namespace

void ModelArguments::AddTo(CLI::App* app) {
  const CLI::Validator effect = CLI::IsMember(EffectRegistry::Default().names()).description("");
  const CLI::Validator parameter = CLI::IsMember(EffectAndParameterNames()).description("");
  auto* effects = app->add_option("--effects", choice.effects,
                                  "the model's effects, replaces the files' list; list_effects "
                                  "shows all")
                      ->delimiter(',')
                      ->allow_extra_args(false)
                      ->check(effect)
                      ->type_name("a,b");
  app->add_option("--without", choice.without, "effects to leave out of the files' list")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(effect)
      ->type_name("a,b")
      ->excludes(effects);
  app->add_option("--free", choice.free, "estimate these: full names (thrust.k_f) or effects")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(parameter)
      ->type_name("a,b");
  app->add_option("--freeze", choice.freeze, "hold these: full names (rotor_torque.k_m) or effects")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(parameter)
      ->type_name("a,b");
}

void ModelArguments::AddParametersTo(CLI::App* app, const std::string& help) {
  app->add_option("--parameters", parameters_file, help)->type_name("FILE");
}

Vehicle ModelArguments::Configure(const Vehicle& file_vehicle) {
  if (parameters_file.empty()) return odmc::Configure(file_vehicle, choice);
  choice.parameters = LoadParameters(parameters_file);
  try {
    return odmc::Configure(file_vehicle, choice);
  } catch (const std::invalid_argument& e) {
    RefuseFile(parameters_file, e.what());
  }
}

void EstimatorArguments::AddTo(CLI::App* app, bool with_window) {
  app->add_option("--config", config_file, "estimator options, YAML")->type_name("FILE");
  app->add_option("--keyframe-rate", keyframe_rate_hz, "at most this many keyframes a second [Hz]")
      ->check(Positive());
  if (with_window) {
    app->add_option("--window", window_s, "length of the sliding window [s]")->check(Positive());
  }
  app->add_option("--threads", threads, "threads that evaluate factors")->check(Positive());
  app->add_option("--set", settings,
                  "any option of the estimator, see below; may be given several "
                  "times")
      ->allow_extra_args(false)
      ->type_name("KEY=VALUE");
  app->footer("Estimator options (--config FILE or --set KEY=VALUE) with their defaults:\n" +
              FormatOptions(defaults) + "\n" + kExitStatus);
}

EstimatorOptions AttributionEstimatorOptions() {
  EstimatorOptions options = OfflineOptions();
  options.keyframe_rate_hz = 50.0;
  return options;
}

EstimatorOptions EstimatorArguments::Read() const {
  EstimatorOptions options = defaults;
  if (!config_file.empty()) LoadOptions(config_file, &options);
  if (keyframe_rate_hz > 0.0) options.keyframe_rate_hz = keyframe_rate_hz;
  if (window_s > 0.0) options.window_s = window_s;
  if (threads > 0) options.num_threads = threads;
  for (const std::string& text : settings) {
    const auto [key, value] = Split(text, "=", "--set");
    OptionSetter setter(key, value);
    options.Visit(&setter);
    if (!setter.found()) throw UsageError("--set " + text + ": there is no option '" + key + "'");
  }
  std::string error;
  if (!options.IsValid(&error)) throw UsageError(error);
  return options;
}

std::string DescribeChanges(const EstimatorOptions& options) {
  std::istringstream now(FormatOptions(options)), before(FormatOptions(OfflineOptions()));
  std::string line, default_line;
  std::vector<std::string> changes;
  while (std::getline(now, line) && std::getline(before, default_line)) {
    if (line != default_line) changes.push_back(line);
  }
  return Listed(changes, "defaults");
}

void StateOrigin(const Vehicle& vehicle, double position_noise_m, const EstimatorOptions& options,
                 Calibration* calibration) {
  calibration->parameters.provenance =
      Provenance("calibrate", vehicle,
                 {{"flight", calibration->flight.file},
                  {"position_noise_m", std::to_string(position_noise_m)},
                  {"estimator_options", DescribeChanges(options)}});
  AddTrust(calibration->findings, &calibration->parameters);
}

std::map<std::string, std::string> ProvenanceOf(const CloseLoopOptions& options,
                                                const Vehicle& vehicle,
                                                std::map<std::string, std::string> more) {
  more["estimator_options"] = DescribeChanges(options.estimator);
  more["decision"] = DescribeChanges(options.attribution);
  more["ruled_out"] = Listed(options.ruled_out, "nothing");
  return Provenance("close_loop", vehicle, std::move(more));
}

}  // namespace odmc::tools
