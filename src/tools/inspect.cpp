#include <iostream>

#include "odmc/analysis/flight_inspection.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app(
      "Looks at a recording as a colleague would: streams with rates, gaps and delays against each\n"
      "other; units, frames, rotor order and spins as the data show them, against the vehicle file;\n"
      "phases of the flight; which parameters can be learned from it, and what to fly for the others.\n"
      "Each finding comes with its evidence, the trust it leaves and what would mend it.\n"
      "With --out it writes report.json and report.html.");
  tools::FlightArguments flight;
  std::string vehicle_file, folder;
  bool no_report = false;
  flight.AddTo(&app);
  tools::AddVehicle(&app, &vehicle_file);
  app.add_option("--out", folder, "folder for report.json and report.html")->type_name("DIR");
  app.add_flag("--no-report", no_report, "no report.html");
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const Vehicle vehicle = LoadVehicle(vehicle_file);
    const FlightInspection inspection = InspectFlight(flight.Read(vehicle), vehicle);
    std::cout << InspectionText(inspection);
    if (folder.empty()) return;
    tools::MakeFolder(folder);
    WriteText(InspectionReport(inspection), tools::In(folder, "report.json"));
    if (!no_report) tools::RenderReport(folder, "render_inspection");
  });
}
