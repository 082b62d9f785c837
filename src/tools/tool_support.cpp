#include "tool_support.h"

#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <new>
#include <utility>

#include "odmc/analysis/report.h"
#include "odmc/effects/effects.h"
#include "odmc/io/options_yaml.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/text/number_text.h"
#include "odmc/text/printable_text.h"
#include "odmc/trajectory/trajectory.h"

namespace odmc::tools {
namespace {

namespace fs = std::filesystem;

constexpr char kPython[] = "/usr/bin/python3";

std::string OneLine(std::string text) {
  while (!text.empty() && text.back() == '\n') text.pop_back();
  std::replace(text.begin(), text.end(), '\n', ' ');
  return Printable(text);
}

int Fail(const std::string& text, int status) {
  std::cerr << "error: " << OneLine(text) << "\n";
  return status;
}

fs::path ExecutableFolder() {
  std::error_code ignored;
  return fs::read_symlink("/proc/self/exe", ignored).parent_path();
}

/// Where the package keeps a script: installed beside or near the tool, or in the source tree.
std::string FindScript(const std::string& name) {
  std::error_code ignored;
  const fs::path folder = ExecutableFolder();
  for (const fs::path& path : {folder / name, folder / "../../share/odmc/scripts" / name,
                               fs::path(ODMC_SOURCE_DIR) / "scripts" / name}) {
    if (fs::is_regular_file(path, ignored)) return path.string();
  }
  return "";
}

CLI::Validator NumberThat(bool may_be_zero) {
  const auto check = [may_be_zero](const std::string& text) -> std::string {
    double number = 0.0;
    const bool sound = ParseNumber(text, &number) && std::isfinite(number) &&
                       (number > 0.0 || (may_be_zero && number == 0.0));
    if (sound) return "";
    return "expected a number " + std::string(may_be_zero ? "of zero or more" : "above zero") +
           ", not '" + text + "'";
  };
  return CLI::Validator(check, may_be_zero ? "NONNEGATIVE" : "POSITIVE");
}

}  // namespace

std::pair<std::string, std::string> Split(const std::string& text, const std::string& separator,
                                          const std::string& option) {
  const size_t at = text.find(separator);
  if (at == std::string::npos || at == 0 || at + separator.size() == text.size()) {
    throw UsageError(option + " '" + text + "': expected NAME" + separator + "VALUE");
  }
  return {text.substr(0, at), text.substr(at + separator.size())};
}

CLI::Validator Positive() { return NumberThat(false); }
CLI::Validator NotNegative() { return NumberThat(true); }

int Run(CLI::App* app, int argc, char** argv, const std::function<void()>& tool) {
  try {
    app->parse(argc, argv);
    tool();
    return 0;
  } catch (const CLI::ParseError& e) {
    if (e.get_exit_code() == 0) return app->exit(e);  // --help
    return Fail(std::string(e.what()) + " (--help explains all)", 2);
  } catch (const UsageError& e) {
    return Fail(std::string(e.what()) + " (--help explains all)", 2);
  } catch (const std::bad_alloc&) {
    return Fail("out of memory", 1);
  } catch (const std::exception& e) {
    return Fail(e.what(), 1);
  }
}

ProgressBar::ProgressBar(std::string label)
    : label_(std::move(label)), on_terminal_(isatty(STDERR_FILENO) != 0) {}

ProgressBar::~ProgressBar() {
  if (on_terminal_ && percent_ >= 0 && percent_ < 100) std::cerr << "\r\033[K" << std::flush;
}

void ProgressBar::Show(double share) {
  constexpr int kWidth = 40;
  const int percent = static_cast<int>(100.0 * std::clamp(share, 0.0, 1.0));
  if (!on_terminal_ || percent == percent_) return;
  percent_ = percent;
  if (percent == 100) {
    std::cerr << "\r\033[K" << std::flush;
    return;
  }
  const int done = kWidth * percent / 100;
  std::cerr << "\r" << label_ << " [" << std::string(done, '#') << std::string(kWidth - done, '.')
            << "] " << percent << " %" << std::flush;
}

std::function<void(double)> ProgressBar::Callback() {
  return [this](double share) { Show(share); };
}

void AddVehicle(CLI::App* app, std::string* file) {
  app->add_option("--vehicle", *file, "vehicle description, YAML")->required()->type_name("FILE");
}

void AddDefaultVehicle(CLI::App* app, std::string* file) {
  for (const fs::path& share :
       {fs::path(ODMC_SOURCE_DIR), ExecutableFolder() / "../../share/odmc"}) {
    *file = (share / "config/vehicles/generic.yaml").string();
    std::error_code ignored;
    if (fs::is_regular_file(*file, ignored)) break;
  }
  app->add_option("--vehicle", *file, "vehicle description, YAML [the generic one]")
      ->type_name("FILE");
}

void AddTrajectory(CLI::App* app, SimulationOptions* options) {
  const auto check = [](const std::string& name) {
    std::string error;
    TrajectoryOptions flown;
    flown.name = name;
    return flown.IsValid(&error) ? "" : error;
  };
  app->add_option("--trajectory", options->trajectory,
                  CLI::detail::join(Trajectory::Names(), ", ") + ", or a waypoint file (*.yaml)")
      ->required()
      ->check(CLI::Validator(check, ""))
      ->type_name("NAME|FILE");
  app->add_option("--duration", options->duration_s, "of a whole flight [s]")
      ->capture_default_str()
      ->check(Positive());
}

void AddExitStatus(CLI::App* app) { app->footer(kExitStatus); }

void AddFolder(CLI::App* app, std::string* folder, bool* no_report) {
  app->add_option("--out", *folder, "folder for the results; made where missing, files overwritten")
      ->required()
      ->type_name("DIR");
  if (no_report != nullptr) app->add_flag("--no-report", *no_report, "do not draw report.html");
}

void AddJobs(CLI::App* app, int* jobs) {
  app->add_option("--jobs", *jobs, "flights at a time")->check(Positive())->capture_default_str();
}

void MakeFolder(const std::string& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (!fs::is_directory(folder)) throw std::runtime_error(folder + ": cannot be made a folder");
}

std::string In(const std::string& folder, const std::string& name) {
  return (fs::path(folder) / name).string();
}

void WriteCalibration(const Calibration& calibration, const FlightLog& log,
                      const DynamicModel& model, const std::string& folder) {
  SaveParameters(calibration.parameters, In(folder, "parameters.yaml"));
  WriteHistory(calibration, log, model, In(folder, "history.csv"));
  WriteTiming(calibration, In(folder, "timing.csv"));
  WritePhases(calibration, In(folder, "phases.csv"));
  WriteText(CalibrationReport(calibration, model), In(folder, "report.json"));
}

std::map<std::string, std::string> Provenance(const std::string& tool, const Vehicle& vehicle,
                                              std::map<std::string, std::string> more) {
  more["tool"] = tool;
  more["version"] = ODMC_VERSION;
  more["vehicle"] = vehicle.name;
  more["mass_kg"] = FormatNumber(vehicle.mass_kg);
  return more;
}

void RenderReport(const std::string& folder, const std::string& script_name) {
  const auto warn = [&](const std::string& why) {
    std::cerr << "warning: the pictures of " << Printable(folder) << " were not drawn: " << why
              << "\n";
  };
  const std::string script = FindScript(script_name);
  if (script.empty()) return warn(script_name + " is not installed");
  std::cout << std::flush;
  const pid_t child = fork();
  if (child < 0) return warn("no process to be had");
  if (child == 0) {
    execl(kPython, kPython, script.c_str(), folder.c_str(), static_cast<char*>(nullptr));
    _exit(127);
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) warn(script + " failed");
}

Vehicle NominalVehicle() {
  constexpr double kX = 0.095, kY = 0.11, kRadius = 0.0635;
  Vehicle vehicle;
  vehicle.name = "nominal";
  vehicle.mass_kg = 0.75;
  vehicle.inertia_kg_m2 = {2.5e-3, 2.1e-3, 4.3e-3};
  vehicle.rotors = {{{kX, -kY, 0.0}, 1.0, kRadius},
                    {{kX, kY, 0.0}, -1.0, kRadius},
                    {{-kX, kY, 0.0}, 1.0, kRadius},
                    {{-kX, -kY, 0.0}, -1.0, kRadius}};
  vehicle.effects = DefaultEffects();
  return vehicle;
}

SimulationNoise ReadNoise(const std::string& name) {
  if (name == "none") return SimulationNoise::None();
  SimulationNoise noise;
  if (name != "default") LoadOptions(name, &noise);
  return noise;
}

}  // namespace odmc::tools
