#include "odmc/analysis/effect_catalogue.h"

#include <algorithm>
#include <string>
#include <vector>

#include "odmc/model/dynamic_model.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

std::string SignOf(PhysicalSign sign) {
  if (sign == PhysicalSign::kAny) return "any";
  return sign == PhysicalSign::kPositive ? "> 0" : "< 0";
}

std::string StateOf(const ModelParameter& parameter) {
  return parameter.estimated ? "estimated" : "frozen";
}

/// A bar would end the cell.
std::string Cell(std::string text) {
  for (size_t at = text.find('|'); at != std::string::npos; at = text.find('|', at + 2)) {
    text.replace(at, 1, "\\|");
  }
  return text;
}

/// Every registered effect as a model of its own: no model has room for all of them.
std::vector<DynamicModel> EachAlone(const Vehicle& vehicle) {
  std::vector<DynamicModel> models;
  for (const std::string& name : EffectRegistry::Default().names()) {
    models.emplace_back(vehicle, std::vector<std::string>{name});
  }
  return models;
}

}  // namespace

std::string CatalogueText(const Vehicle& vehicle) {
  std::string text;
  for (const DynamicModel& model : EachAlone(vehicle)) {
    const EffectDescription& d = model.effect(0).description();
    text += (text.empty() ? "" : "\n") + d.name + ": " + d.title + "\n  " + d.formula +
            "\n  source: " + d.source + "\n  limits: " + d.validity + "\n";
    for (const ModelParameter& p : model.parameters()) {
      text += "    " + p.full_name + " [" + p.spec.unit + "]  " + p.spec.description + "; prior " +
              Rounded(p.spec.prior_value) + " +- " + Rounded(p.spec.prior_sigma) + ", sign " +
              SignOf(p.spec.sign) + ", " + StateOf(p) + "\n";
    }
  }
  return text;
}

std::string CatalogueMarkdown(const Vehicle& vehicle) {
  const std::vector<DynamicModel> models = EachAlone(vehicle);
  std::string text = "| Effect | What | Formula | Source | Limits |\n|---|---|---|---|---|\n";
  for (const DynamicModel& model : models) {
    const EffectDescription& d = model.effect(0).description();
    text += "| `" + d.name + "` | " + Cell(d.title) + " | `" + Cell(d.formula) + "` | " +
            Cell(d.source) + " | " + Cell(d.validity) + " |\n";
  }
  text += "\n| Parameter | Unit | Meaning | Sign | Prior (" + Cell(vehicle.name) +
          ") | By default |\n|---|---|---|---|---|---|\n";
  for (const DynamicModel& model : models) {
    for (const ModelParameter& p : model.parameters()) {
      text += "| `" + p.full_name + "` | " + Cell(p.spec.unit) + " | " + Cell(p.spec.description) +
              " | " + SignOf(p.spec.sign) + " | " + Rounded(p.spec.prior_value) + " ± " +
              Rounded(p.spec.prior_sigma) + " | " + StateOf(p) + " |\n";
    }
  }
  return text;
}

}  // namespace odmc
