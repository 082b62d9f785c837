#include <iostream>

#include "flight_arguments.h"
#include "odmc/analysis/flight_inspection.h"
#include "odmc/analysis/report.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/frame_layout.h"
#include "tool_support.h"

namespace {

using namespace odmc;

FlightInspection Look(const tools::FlightArguments& flight, const std::string& vehicle_file,
                      int num_rotors) {
  if (!vehicle_file.empty()) {
    const Vehicle vehicle = LoadVehicle(vehicle_file);
    return InspectFlight(flight.Read(vehicle), vehicle);
  }
  if (FramesOf(num_rotors).empty()) throw tools::UsageError("--rotors must be 4, 6 or 8");
  Vehicle unknown;  // says only how many rotors there are
  unknown.rotors.resize(static_cast<size_t>(num_rotors));
  return InspectFlightAlone(flight.Read(unknown), num_rotors);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Looks at a recording as a colleague would: streams with rates, gaps and delays against "
      "each\n"
      "other; units, frames, rotor order and spins as the data show them, against the vehicle "
      "file;\n"
      "phases of the flight; which parameters can be learned from it, and what to fly for the "
      "others.\n"
      "Each finding comes with its evidence, the trust it leaves and what would mend it.\n"
      "Without --vehicle it says what needs none, and which order and spins of the rotors would "
      "fit.\n"
      "With --out it writes report.json and report.html.");
  tools::FlightArguments flight;
  std::string vehicle_file, folder;
  bool no_report = false;
  int num_rotors = 4;
  flight.AddTo(&app);
  app.add_option("--vehicle", vehicle_file, "vehicle description, YAML")->type_name("FILE");
  app.add_option("--rotors", num_rotors, "of the vehicle, without --vehicle: 4, 6 or 8")
      ->capture_default_str();
  app.add_option("--out", folder, "folder for report.json and report.html")->type_name("DIR");
  app.add_flag("--no-report", no_report, "no report.html");
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const FlightInspection inspection = Look(flight, vehicle_file, num_rotors);
    std::cout << InspectionText(inspection);
    if (folder.empty()) return;
    tools::MakeFolder(folder);
    WriteText(InspectionReport(inspection), tools::In(folder, "report.json"));
    if (!no_report) tools::RenderReport(folder, "render_inspection");
  });
}
