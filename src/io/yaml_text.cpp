#include "odmc/io/yaml_text.h"

#include "odmc/text/format.h"
#include "odmc/text/number_text.h"

namespace odmc {

std::string YamlQuoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      quoted += std::string("\\") + c;
    } else if (c == '\n') {
      quoted += "\\n";
    } else if (static_cast<unsigned char>(c) < 0x20) {
      quoted += Format("\\x%02x", static_cast<unsigned>(c));
    } else {
      quoted += c;
    }
  }
  return quoted + "\"";
}

std::string YamlList(const Eigen::Ref<const Eigen::VectorXd>& numbers) {
  std::vector<std::string> texts;
  for (const double number : numbers) texts.push_back(FormatYamlNumber(number));
  return "[" + Listed(texts) + "]";
}

std::string YamlMount(const SensorMount& mount) {
  const bool is_body =
      mount.p_BS.isZero(0.0) && mount.q_BS.isApprox(Eigen::Quaterniond::Identity(), 1e-12);
  if (is_body && !mount.estimate) return "{frame: body}";
  return "{frame: sensor, p_BS_m: " + YamlList(mount.p_BS) +
         ", q_BS_xyzw: " + YamlList(mount.q_BS.coeffs()) +
         ", estimate: " + (mount.estimate ? "true" : "false") + "}";
}

}  // namespace odmc
