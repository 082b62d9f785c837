#include "odmc/io/actuator_yaml.h"

#include <cmath>
#include <fstream>
#include <stdexcept>

#include "odmc/text/number_text.h"
#include "text_file.h"
#include "yaml_reader.h"

namespace odmc {
namespace {

std::optional<MeasuredValue> ReadMeasured(const YamlValue& parent, const std::string& key) {
  const auto value = parent.Find(key);
  if (!value) return std::nullopt;
  value->AllowKeys({"value", "sigma"});
  return MeasuredValue{value->Get("value").PositiveNumber(), value->Get("sigma").PositiveNumber()};
}

double NotNegative(const YamlValue& value) {
  const double number = value.Number();
  if (number < 0.0) value.Fail("must not be negative");
  return number;
}

Motor ReadMotor(const YamlValue& value, CommandUnit unit) {
  value.AllowKeys({"root", "linear", "constant", "U_a", "S_1", "S_2", "delay_s"});
  Motor motor;
  motor.esc.root = value.Get("root").Number();
  motor.esc.linear = value.Get("linear").Number();
  motor.esc.constant = value.Get("constant").Number();
  motor.esc.start = ThrottleOf(value.Get("U_a").Number(), unit);
  motor.dynamics.S1 = value.Get("S_1").PositiveNumber();
  motor.dynamics.S2 = NotNegative(value.Get("S_2"));
  motor.delay_s = value.Get("delay_s").Number();
  if (std::abs(motor.delay_s) > 1.0) value.Get("delay_s").Fail("is more than 1 s");
  return motor;
}

std::string YamlMeasured(const MeasuredValue& m) {
  return "{value: " + FormatYamlNumber(m.value) + ", sigma: " + FormatYamlNumber(m.sigma) + "}";
}

}  // namespace

Actuator ParseActuator(const std::string& text, const std::string& file) {
  const YamlValue root = YamlValue::Parse(text, file);
  root.AllowKeys({"command_unit", "uses_voltage", "knows_dynamics", "sigma_steady_rad_s",
                  "sigma_response_rad_s", "k_f", "k_m", "motors"});
  Actuator actuator;
  actuator.command_unit =
      *CommandUnitNamed(root.Get("command_unit").OneOf({"us", "raw16", "fraction"}));
  actuator.uses_voltage = root.Get("uses_voltage").Bool();
  actuator.knows_dynamics = root.Get("knows_dynamics").Bool();
  actuator.sigma_steady_rad_s = NotNegative(root.Get("sigma_steady_rad_s"));
  actuator.sigma_response_rad_s = NotNegative(root.Get("sigma_response_rad_s"));
  actuator.k_f = ReadMeasured(root, "k_f");
  actuator.k_m = ReadMeasured(root, "k_m");
  for (const YamlValue& item : root.Get("motors").Items())
    actuator.motors.push_back(ReadMotor(item, actuator.command_unit));
  if (actuator.motors.empty()) root.Get("motors").Fail("must list at least one motor");
  return actuator;
}

Actuator LoadActuator(const std::string& file) { return ParseActuator(ReadText(file), file); }

std::string FormatActuator(const Actuator& actuator, const std::string& provenance) {
  const auto number = [](double value) { return FormatYamlNumber(value); };
  std::string text = "# " + provenance + "\n";
  text +=
      "# Motors and ESCs, model.md section 11. With throttle x = 0 .. 1, battery voltage V and\n"
      "# rotor speed w: dw/dt = root V sqrt(x - x_a) + linear x + constant - S_1 w - S_2 w^2.\n"
      "# U_a is x_a as a command. root in rad/s^2/V, linear and constant in rad/s^2, S_1 in 1/s, "
      "S_2 in\n# 1/rad, k_f in N s^2, k_m in N m s^2.\n";
  text += std::string("command_unit: ") + NameOf(actuator.command_unit) + "\n";
  text += std::string("uses_voltage: ") + (actuator.uses_voltage ? "true" : "false") + "\n";
  text += std::string("knows_dynamics: ") + (actuator.knows_dynamics ? "true" : "false") + "\n";
  text += "sigma_steady_rad_s: " + number(actuator.sigma_steady_rad_s) + "\n";
  text += "sigma_response_rad_s: " + number(actuator.sigma_response_rad_s) + "\n";
  if (actuator.k_f) text += "k_f: " + YamlMeasured(*actuator.k_f) + "\n";
  if (actuator.k_m) text += "k_m: " + YamlMeasured(*actuator.k_m) + "\n";
  text += "motors:  # one for all rotors, or one each in the vehicle file's order\n";
  for (const Motor& motor : actuator.motors) {
    text += "  - {root: " + number(motor.esc.root) + ", linear: " + number(motor.esc.linear) +
            ", constant: " + number(motor.esc.constant) +
            ", U_a: " + number(CommandOf(motor.esc.start, actuator.command_unit)) +
            ",\n     S_1: " + number(motor.dynamics.S1) + ", S_2: " + number(motor.dynamics.S2) +
            ", delay_s: " + number(motor.delay_s) + "}\n";
  }
  return text;
}

void SaveActuator(const Actuator& actuator, const std::string& provenance,
                  const std::string& file) {
  std::ofstream stream(file);
  stream << FormatActuator(actuator, provenance);
  stream.close();
  if (!stream) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
