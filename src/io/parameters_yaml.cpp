#include "odmc/io/parameters_yaml.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <stdexcept>

#include "known_parameters.h"
#include "odmc/io/yaml_text.h"
#include "odmc/model/effect.h"
#include "odmc/text/format.h"
#include "odmc/text/number_text.h"
#include "text_file.h"
#include "yaml_reader.h"

namespace odmc {
namespace {

// ---- Reading -----------------------------------------------------------------------------------

std::vector<std::string> ReadEffects(const YamlValue& value) {
  std::vector<std::string> effects;
  const std::vector<std::string>& known = EffectRegistry::Default().names();
  for (const YamlValue& item : value.Items()) {
    effects.push_back(item.OneOf(known));
    if (std::count(effects.begin(), effects.end(), effects.back()) > 1) {
      item.Fail("effect '" + effects.back() + "' is listed twice");
    }
  }
  return effects;
}

ParameterEstimate ReadEstimate(const std::string& name, const YamlValue& value,
                               const ParameterSpec& spec) {
  value.AllowKeys({"value", "sigma", "scatter", "unit", "state", "observable"});
  ParameterEstimate p;
  p.full_name = name;
  p.unit = spec.unit;
  p.estimated = !spec.frozen_by_default;
  p.value = value.Get("value").Number();
  if (const auto sigma = value.Find("sigma")) p.sigma = sigma->Number();
  if (p.sigma < 0.0) value.Get("sigma").Fail("must not be negative");
  if (const auto scatter = value.Find("scatter")) p.scatter = scatter->Number();
  if (p.scatter < 0.0) value.Get("scatter").Fail("must not be negative");
  if (const auto unit = value.Find("unit")) {
    if (unit->Text() != spec.unit) {
      unit->Fail("is '" + unit->Text() + "'; this program keeps " + name + " in '" + spec.unit +
                 "'");
    }
  }
  if (const auto state = value.Find("state")) {
    p.estimated = state->OneOf({"estimated", "frozen"}) == "estimated";
  }
  if (const auto observable = value.Find("observable")) p.observable = observable->Bool();
  if (spec.transform == ParameterTransform::kLog && !(p.value > 0.0)) {
    value.Get("value").Fail("must be positive, not " + FormatNumber(p.value));
  }
  return p;
}

void ReadEstimates(const YamlValue& value, ParameterSet* set) {
  // The file does not say how many rotors its vehicle has; some effects have parameters of each.
  Vehicle vehicle;
  vehicle.rotors.resize(kMaxRotors);
  const std::map<std::string, ParameterSpec> specs = KnownParameters(vehicle);
  value.AllowKeys(NamesOf(specs));
  for (const auto& [name, entry] : value.Entries()) {
    set->parameters.push_back(ReadEstimate(name, entry, specs.at(name)));
  }
}

/// Index in `set.parameters` of every row of the file's matrix.
std::vector<int> ReadOrder(const YamlValue& value, const ParameterSet& set) {
  std::vector<int> order;
  for (const YamlValue& item : value.Items()) {
    const ParameterEstimate* p = set.Find(item.Text());
    if (p == nullptr) item.Fail("'" + item.Text() + "' is not among the parameters");
    order.push_back(static_cast<int>(p - set.parameters.data()));
    if (std::count(order.begin(), order.end(), order.back()) > 1) item.Fail("is listed twice");
  }
  if (order.size() != set.parameters.size()) value.Fail("must name every parameter once");
  return order;
}

/// Judges correlations, so that units do not matter. A matrix written with six digits passes.
void CheckCovariance(const Eigen::MatrixXd& covariance, const YamlValue& matrix) {
  constexpr double kRounding = 1e-6;
  if (covariance.size() == 0) return;
  if (covariance.diagonal().minCoeff() < 0.0) matrix.Fail("has a negative variance");
  const Eigen::VectorXd sigma = covariance.diagonal().cwiseSqrt();
  const Eigen::VectorXd inverse = sigma.unaryExpr([](double s) { return s > 0.0 ? 1.0 / s : 0.0; });
  const Eigen::MatrixXd correlation = inverse.asDiagonal() * covariance * inverse.asDiagonal();
  if (!correlation.allFinite()) matrix.Fail("is not finite once scaled to correlations");
  for (Eigen::Index i = 0; i < sigma.size(); ++i) {
    const bool is_zero = covariance.row(i).isZero(0.0) && covariance.col(i).isZero(0.0);
    if (sigma[i] == 0.0 && !is_zero) matrix.Fail("has a variance of zero beside covariances");
  }
  const Eigen::MatrixXd asymmetry = correlation - correlation.transpose();
  if (asymmetry.cwiseAbs().maxCoeff() > kRounding) matrix.Fail("is not symmetric");
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(
      0.5 * (correlation + correlation.transpose()), Eigen::EigenvaluesOnly);
  const double least = solver.eigenvalues().minCoeff();
  if (!(least >= -kRounding * static_cast<double>(sigma.size()))) {
    matrix.Fail("is not positive: the least eigenvalue of its correlations is " +
                FormatNumber(least));
  }
}

Eigen::MatrixXd ReadCovariance(const YamlValue& value, const ParameterSet& set) {
  value.AllowKeys({"order", "matrix"});
  const std::vector<int> order = ReadOrder(value.Get("order"), set);
  const YamlValue matrix = value.Get("matrix");
  const std::vector<YamlValue> rows = matrix.Items();
  if (rows.size() != order.size()) matrix.Fail("must have one row per entry of order");
  Eigen::MatrixXd covariance(order.size(), order.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    const std::vector<double> row = rows[i].Numbers();
    if (row.size() != order.size()) rows[i].Fail("must have one number per entry of order");
    for (size_t j = 0; j < row.size(); ++j) covariance(order[i], order[j]) = row[j];
  }
  CheckCovariance(covariance, matrix);
  return covariance;
}

// ---- Writing -----------------------------------------------------------------------------------

std::string Finite(double value, const std::string& key) {
  if (!std::isfinite(value)) throw std::invalid_argument(key + " is not finite, will not be saved");
  return FormatYamlNumber(value);
}

std::string FormatEstimate(const ParameterEstimate& p) {
  return "  " + p.full_name + ": {value: " + Finite(p.value, p.full_name + ".value") +
         ", sigma: " + Finite(p.sigma, p.full_name + ".sigma") +
         (p.scatter > 0.0 ? ", scatter: " + Finite(p.scatter, p.full_name + ".scatter") : "") +
         ", unit: " + YamlQuoted(p.unit) + ", state: " + (p.estimated ? "estimated" : "frozen") +
         ", observable: " + (p.observable ? "true" : "false") + "}\n";
}

std::string FormatCovariance(const ParameterSet& set) {
  const auto n = static_cast<Eigen::Index>(set.parameters.size());
  if (set.covariance.rows() != n || set.covariance.cols() != n) {
    throw std::invalid_argument("covariance must have one row and column per parameter");
  }
  std::vector<std::string> names;
  for (const ParameterEstimate& p : set.parameters) names.push_back(p.full_name);
  std::string text = "covariance:\n  order: [" + Listed(names) + "]\n  matrix:\n";
  for (Eigen::Index i = 0; i < n; ++i) {
    std::vector<std::string> row;
    for (Eigen::Index j = 0; j < n; ++j) {
      row.push_back(Finite(set.covariance(i, j), "covariance of " + names[i] + ", " + names[j]));
    }
    text += "    - [" + Listed(row) + "]\n";
  }
  return text;
}

}  // namespace

ParameterSet ParseParameters(const std::string& text, const std::string& file) {
  const YamlValue root = YamlValue::Parse(text, file);
  root.AllowKeys({"effects", "parameters", "covariance", "provenance"});
  ParameterSet set;
  set.effects = ReadEffects(root.Get("effects"));
  ReadEstimates(root.Get("parameters"), &set);
  if (const auto covariance = root.Find("covariance")) {
    set.covariance = ReadCovariance(*covariance, set);
  }
  if (const auto provenance = root.Find("provenance")) {
    for (const auto& [key, value] : provenance->Entries()) set.provenance[key] = value.Text();
  }
  return set;
}

ParameterSet LoadParameters(const std::string& file) {
  return ParseParameters(ReadText(file), file);
}

std::string FormatParameters(const ParameterSet& set) {
  std::string text = "# Dynamic model of a vehicle: SI units, sigma is one standard deviation.\n";
  text += "effects: [" + Listed(set.effects) + "]\n";
  text += set.parameters.empty() ? "parameters: {}\n" : "parameters:\n";
  for (const ParameterEstimate& p : set.parameters) text += FormatEstimate(p);
  if (set.covariance.size() > 0) text += FormatCovariance(set);
  if (!set.provenance.empty()) text += "provenance:\n";
  for (const auto& [key, value] : set.provenance)
    text += "  " + YamlQuoted(key) + ": " + YamlQuoted(value) + "\n";
  return text;
}

void SaveParameters(const ParameterSet& set, const std::string& file) {
  const std::string text = FormatParameters(set);
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw std::runtime_error(file + ": cannot be written");
}

}  // namespace odmc
