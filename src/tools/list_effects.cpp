#include <iostream>

#include "odmc/analysis/effect_catalogue.h"
#include "odmc/io/vehicle_yaml.h"
#include "tool_support.h"

int main(int argc, char** argv) {
  using namespace odmc;
  CLI::App app("Prints the effects a model can have: formula, source, validity, parameters.");
  std::string vehicle_file;
  bool markdown = false;
  app.add_flag("--markdown", markdown, "as a table for the documentation");
  app.add_option("--vehicle", vehicle_file,
                 "vehicle description, YAML, for the priors; default: a 0.75 kg quadrotor")
      ->type_name("FILE");
  tools::AddExitStatus(&app);
  return tools::Run(&app, argc, argv, [&] {
    const Vehicle vehicle =
        vehicle_file.empty() ? tools::NominalVehicle() : LoadVehicle(vehicle_file);
    std::cout << (markdown ? CatalogueMarkdown(vehicle) : CatalogueText(vehicle));
  });
}
