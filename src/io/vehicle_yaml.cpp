#include "odmc/io/vehicle_yaml.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "known_parameters.h"
#include "odmc/effects/effects.h"
#include "odmc/io/actuator_yaml.h"
#include "odmc/model/effect.h"
#include "odmc/model/plausibility.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "text_file.h"
#include "yaml_reader.h"

namespace odmc {
namespace {

/// A stand's air is not that of flight: what it measures is known to this share at best.
constexpr double kLeastBenchShare = 0.02;

/// A positive number within limits that only another unit would break.
double Plausible(const YamlValue& value, double low, double high, const std::string& hint) {
  const double number = value.PositiveNumber();
  if (number < low || number > high) {
    value.Fail(FormatNumber(number) + " is implausible; " + hint);
  }
  return number;
}

Eigen::Vector3d ReadInertia(const YamlValue& value, double mass_kg) {
  const Eigen::Vector3d inertia = value.Vector3();
  if (!(inertia.minCoeff() > 0.0)) value.Fail("must be three positive numbers");
  // The radius of gyration tells units apart, whatever the size of the vehicle.
  const Eigen::Vector3d radius = (inertia / mass_kg).cwiseSqrt();
  if (radius.minCoeff() < 1e-3 || radius.maxCoeff() > 5.0) {
    value.Fail("is implausible for " + FormatNumber(mass_kg) +
               " kg; is it in kg m^2 (1 g cm^2 is 1.0e-07 kg m^2)?");
  }
  return inertia;
}

Eigen::Vector3d ReadRotorPosition(const YamlValue& value) {
  const Eigen::Vector3d position = value.Vector3();
  const double distance = position.norm();
  if (distance > 5.0) {
    value.Fail(FormatNumber(distance) + " m from the origin; is it in metres, not millimetres?");
  }
  if (distance < 1e-3) {
    value.Fail("is less than 1 mm from the origin; is it in metres, from the body origin?");
  }
  return position;
}

Rotor ReadRotor(const YamlValue& value) {
  value.AllowKeys({"position_m", "spin", "radius_m"});
  Rotor rotor;
  rotor.p_BP = ReadRotorPosition(value.Get("position_m"));
  rotor.spin = value.Get("spin").OneOf({"cw", "ccw"}) == "cw" ? 1.0 : -1.0;
  rotor.radius_m = Plausible(value.Get("radius_m"), 1e-3, 3.0, "is it in metres?");
  return rotor;
}

std::vector<Rotor> ReadRotors(const YamlValue& value) {
  std::vector<Rotor> rotors;
  for (const YamlValue& item : value.Items()) {
    rotors.push_back(ReadRotor(item));
    for (size_t j = 0; j + 1 < rotors.size(); ++j) {
      if ((rotors[j].p_BP - rotors.back().p_BP).norm() < 1e-6) {
        item.Get("position_m")
            .Fail("is the same as that of rotors[" + std::to_string(j) +
                  "]: each rotor has its own place");
      }
    }
  }
  return rotors;
}

Eigen::Quaterniond ReadRotation(const YamlValue& value) {
  const std::vector<double> q = value.Numbers();
  if (q.size() != 4) value.Fail("must be four numbers [x, y, z, w]");
  const Eigen::Quaterniond rotation(q[3], q[0], q[1], q[2]);
  if (std::abs(rotation.norm() - 1.0) > 1e-3) {
    value.Fail("has norm " + FormatNumber(rotation.norm()) + "; must be a unit quaternion");
  }
  return rotation.normalized();
}

SensorMount ReadMount(const YamlValue& value) {
  value.AllowKeys({"frame", "p_BS_m", "q_BS_xyzw", "estimate", "p_BS_sigma_m", "q_BS_sigma_rad"});
  SensorMount mount;
  if (const auto sigma = value.Find("p_BS_sigma_m")) {
    mount.p_BS_sigma_m = Plausible(*sigma, 1e-5, 1.0, "is it in metres, and positive?");
  }
  if (const auto sigma = value.Find("q_BS_sigma_rad")) {
    mount.q_BS_sigma_rad = Plausible(*sigma, 1e-5, 1.0, "is it in radians, and positive?");
  }
  if (const auto estimate = value.Find("estimate")) mount.estimate = estimate->Bool();
  const auto position = value.Find("p_BS_m");
  const auto rotation = value.Find("q_BS_xyzw");
  const auto frame = value.Find("frame");
  if (!frame || frame->OneOf({"body", "sensor"}) == "body") {
    const std::string why = "needs frame: sensor; with frame: body the sensor's pose is the body's";
    if (position) position->Fail(why);
    if (rotation) rotation->Fail(why);
    if (mount.estimate) value.Get("estimate").Fail("true " + why);
    return mount;
  }
  if (position) mount.p_BS = position->Vector3();
  if (rotation) mount.q_BS = ReadRotation(*rotation);
  if (mount.p_BS.norm() > 5.0) position->Fail("is more than 5 m away; is it in metres?");
  return mount;
}

std::string ReadEffectName(const YamlValue& value) {
  const std::string name = value.Text();
  const std::vector<std::string>& known = EffectRegistry::Default().names();
  if (!EffectRegistry::Default().Has(name)) {
    const std::string closest = ClosestName(name, known);
    value.Fail("unknown effect '" + name + "'; " +
               (closest.empty() ? "" : "did you mean " + closest + "? ") +
               "Known are: " + Listed(known));
  }
  return name;
}

std::vector<std::string> ReadEffects(const YamlValue& value) {
  std::vector<std::string> effects;
  for (const YamlValue& item : value.Items()) {
    const std::string name = ReadEffectName(item);
    if (std::count(effects.begin(), effects.end(), name) > 0) {
      item.Fail("effect '" + name + "' is listed twice");
    }
    effects.push_back(name);
  }
  if (effects.empty()) value.Fail("must list at least one effect");
  return effects;
}

void AppendOnce(const std::string& name, std::vector<std::string>* effects) {
  if (std::count(effects->begin(), effects->end(), name) == 0) effects->push_back(name);
}

ParameterSetting ReadSetting(const YamlValue& value) {
  value.AllowKeys({"value", "sigma", "state"});
  ParameterSetting setting;
  if (const auto number = value.Find("value")) setting.value = number->Number();
  if (const auto number = value.Find("sigma")) setting.sigma = number->PositiveNumber();
  if (const auto word = value.Find("state")) {
    setting.estimated = word->OneOf({"estimated", "frozen"}) == "estimated";
  }
  return setting;
}

void CheckSetting(const YamlValue& value, const std::string& name, const ParameterSpec& spec,
                  const Vehicle& vehicle) {
  const ParameterSetting& setting = vehicle.parameters.at(name);
  if (setting.value && spec.transform == ParameterTransform::kLog && !(*setting.value > 0.0)) {
    value.Get("value").Fail("must be positive, not " + FormatNumber(*setting.value));
  }
  const SettingDoubt doubt = DoubtOf(name, spec, setting, vehicle);
  if (!doubt.key.empty()) value.Get(doubt.key).Fail(doubt.sentence);
}

/// A pose that is the body's by definition has nothing to estimate.
void RefuseFixedExtrinsic(const YamlValue& value, const std::string& name, const Vehicle& vehicle) {
  const bool odometry = name.rfind("odometry_extrinsics.", 0) == 0;
  const bool imu = name.rfind("imu_extrinsics.", 0) == 0;
  if (!odometry && !imu) return;
  if (!vehicle.parameters.at(name).estimated.value_or(false)) return;
  if ((odometry ? vehicle.odometry : vehicle.imu.value_or(SensorMount())).estimate) return;
  value.Get("state").Fail(std::string("estimated needs ") + (odometry ? "odometry" : "imu") +
                          ": {frame: sensor, estimate: true}");
}

void ReadParameters(const YamlValue& value, Vehicle* vehicle) {
  const std::map<std::string, ParameterSpec> specs = KnownParameters(*vehicle);
  value.AllowKeys(NamesOf(specs));
  for (const auto& [name, entry] : value.Entries()) {
    vehicle->parameters[name] = ReadSetting(entry);
    CheckSetting(entry, name, specs.at(name), *vehicle);
    RefuseFixedExtrinsic(entry, name, *vehicle);
  }
}

/// "path/to/quad.yaml" -> "quad".
std::string Stem(const std::string& file) {
  const size_t slash = file.find_last_of('/');
  const std::string name = slash == std::string::npos ? file : file.substr(slash + 1);
  return name.substr(0, name.find_last_of('.'));
}

void ReadBody(const YamlValue& root, Vehicle* vehicle) {
  vehicle->mass_kg = Plausible(root.Get("mass_kg"), 1e-3, 100.0, "is it in kilograms?");
  if (const auto gravity = root.Find("gravity_m_s2")) {
    vehicle->gravity_m_s2 = Plausible(*gravity, 0.1, 30.0, "is it in m/s^2, and positive?");
  }
  vehicle->inertia_kg_m2 = ReadInertia(root.Get("inertia_kg_m2"), vehicle->mass_kg);
  vehicle->rotors = ReadRotors(root.Get("rotors"));
}

void ReadModel(const YamlValue& root, Vehicle* vehicle) {
  const auto effects = root.Find("effects");
  vehicle->effects = effects ? ReadEffects(*effects) : DefaultEffects();
  // A mount that is to be estimated is an effect; asking for it once is enough.
  if (vehicle->odometry.estimate) AppendOnce("odometry_extrinsics", &vehicle->effects);
  if (vehicle->imu && vehicle->imu->estimate) AppendOnce("imu_extrinsics", &vehicle->effects);
  if (const auto parameters = root.Find("parameters")) ReadParameters(*parameters, vehicle);
}

/// A file beside the vehicle file.
void ReadActuator(const YamlValue& value, const std::string& vehicle_file, Vehicle* vehicle) {
  const std::filesystem::path name = value.Text();
  const std::filesystem::path folder = std::filesystem::path(vehicle_file).parent_path();
  try {
    IncludeActuator(LoadActuator((name.is_absolute() ? name : folder / name).string()), vehicle);
  } catch (const std::invalid_argument& e) {
    value.Fail(e.what());
  }
}

}  // namespace

void IncludeActuator(const Actuator& actuator, Vehicle* vehicle) {
  const auto motors = static_cast<int>(actuator.motors.size());
  if (motors != 1 && motors != vehicle->num_rotors()) {
    throw std::invalid_argument("the actuator has " + std::to_string(motors) +
                                " motors, the vehicle " + std::to_string(vehicle->num_rotors()) +
                                " rotors");
  }
  vehicle->actuator = actuator;
  const auto use = [vehicle](const std::string& name,
                             const std::optional<MeasuredValue>& measured) {
    if (!measured) return;
    ParameterSetting& setting = vehicle->parameters[name];
    if (setting.value) return;
    setting.value = measured->value;
    setting.sigma = std::max(measured->sigma, kLeastBenchShare * measured->value);
    if (!setting.estimated) setting.estimated = true;
  };
  use("rotor_torque.k_m", actuator.k_m);
  use("thrust.k_f", actuator.k_f);
}

Vehicle ParseVehicle(const std::string& text, const std::string& file) {
  const YamlValue root = YamlValue::Parse(text, file);
  root.AllowKeys({"name", "mass_kg", "gravity_m_s2", "inertia_kg_m2", "rotors", "odometry", "imu",
                  "effects", "parameters", "actuator"});
  Vehicle vehicle;
  ReadBody(root, &vehicle);
  if (const auto odometry = root.Find("odometry")) vehicle.odometry = ReadMount(*odometry);
  if (const auto imu = root.Find("imu")) vehicle.imu = ReadMount(*imu);
  std::string error;
  if (!vehicle.IsValid(&error)) root.Fail(error);
  ReadModel(root, &vehicle);
  if (const auto actuator = root.Find("actuator")) ReadActuator(*actuator, file, &vehicle);
  const auto name = root.Find("name");
  vehicle.name = Printable(name ? name->Text() : Stem(file), 80);
  return vehicle;
}

Vehicle LoadVehicle(const std::string& file) { return ParseVehicle(ReadText(file), file); }

}  // namespace odmc
