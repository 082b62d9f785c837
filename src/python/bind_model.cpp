#include <map>
#include <memory>
#include <optional>

#include "bindings.h"
#include "odmc/analysis/model_choice.h"
#include "odmc/effects/effects.h"
#include "odmc/io/parameters_yaml.h"
#include "odmc/io/vehicle_yaml.h"
#include "odmc/model/dynamic_model.h"
#include "odmc/model/parameter_set.h"
#include "tool_support.h"

namespace odmc::python {
namespace {

const char* NameOf(PhysicalSign sign) {
  switch (sign) {
    case PhysicalSign::kPositive:
      return "positive";
    case PhysicalSign::kNegative:
      return "negative";
    case PhysicalSign::kAny:
      break;
  }
  return "any";
}

py::dict SpecOf(const std::string& full_name, const ParameterSpec& spec, bool estimated) {
  py::dict entry;
  entry["name"] = full_name;
  entry["unit"] = spec.unit;
  entry["description"] = spec.description;
  entry["prior_value"] = spec.prior_value;
  entry["prior_sigma"] = spec.prior_sigma;
  entry["sign"] = NameOf(spec.sign);
  entry["estimated"] = estimated;
  return entry;
}

/// Every effect of the catalogue with its parameters, as dictionaries.
py::list EffectsFor(const Vehicle& vehicle) {
  py::list effects;
  for (const std::string& name : EffectRegistry::Default().names()) {
    const std::unique_ptr<Effect> effect = EffectRegistry::Default().Make(name, vehicle);
    const EffectDescription& said = effect->description();
    py::dict entry;
    entry["name"] = name;
    entry["title"] = said.title;
    entry["formula"] = said.formula;
    entry["source"] = said.source;
    entry["validity"] = said.validity;
    entry["adds_wrench"] = effect->adds_wrench();
    entry["shapes_body"] = effect->shapes_body();
    py::list parameters;
    for (const ParameterSpec& spec : effect->parameters()) {
      parameters.append(SpecOf(name + "." + spec.name, spec, !spec.frozen_by_default));
    }
    entry["parameters"] = parameters;
    effects.append(entry);
  }
  return effects;
}

py::list ModelParametersOf(const DynamicModel& model) {
  py::list parameters;
  for (const ModelParameter& p : model.parameters()) {
    parameters.append(SpecOf(p.full_name, p.spec, p.estimated));
  }
  return parameters;
}

/// Flight states, one a row.
struct States {
  Eigen::VectorXd time_s;                                            ///< n
  RowMatrix R_WB;                                                    ///< n×9, row by row
  RowMatrix p_WB, v_AB_B, w_WB_B;                                    ///< n×3
  RowMatrix speed, speed_squared, acceleration, speed_squared_rate;  ///< n×rotors
  RowMatrix load_pull_W;                                             ///< n×3

  Eigen::Index size() const { return time_s.size(); }
  FlightState At(Eigen::Index i) const {
    FlightState state;
    state.time_s = time_s[i];
    state.R_WB = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R_WB.row(i).data());
    state.p_WB = p_WB.row(i).transpose();
    state.v_AB_B = v_AB_B.row(i).transpose();
    state.w_WB_B = w_WB_B.row(i).transpose();
    state.rotors.speed = speed.row(i).transpose();
    state.rotors.speed_squared = speed_squared.row(i).transpose();
    state.rotors.acceleration = acceleration.row(i).transpose();
    state.rotors.speed_squared_rate = speed_squared_rate.row(i).transpose();
    state.load.pull_W = load_pull_W.row(i).transpose();
    return state;
  }
};

/// An array n×rows×columns from one matrix a sample.
class Stack {
 public:
  Stack(Eigen::Index n, Eigen::Index rows, Eigen::Index columns)
      : array_({static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(rows),
                static_cast<py::ssize_t>(columns)}),
        data_(array_.mutable_data()),
        rows_(rows),
        columns_(columns) {}

  /// Needs no GIL.
  template <typename Derived>
  void Set(Eigen::Index i, const Eigen::MatrixBase<Derived>& matrix) {
    Eigen::Map<RowMatrix>(data_ + i * rows_ * columns_, rows_, columns_) = matrix;
  }
  py::array_t<double> array() const { return array_; }

 private:
  py::array_t<double> array_;
  double* data_;
  Eigen::Index rows_, columns_;
};

/// The wrench at each state, with the derivatives where wanted.
py::dict WrenchAt(const DynamicModel& model, const States& states, const Eigen::VectorXd& values,
                  const ConstRows& p_BBcm, bool derivatives) {
  const Eigen::Index n = states.size(), k = model.num_parameters();
  Stack force(n, 1, 3), torque(n, 1, 3);
  Stack d_state(derivatives ? n : 0, 6, kNumFlightStateColumns),
      d_values(derivatives ? n : 0, 6, k), d_p_BBcm(derivatives ? n : 0, 6, 3);
  {
    const py::gil_scoped_release release;
    for (Eigen::Index i = 0; i < n; ++i) {
      Eigen::Vector3d f_B, tau_Bcm_B;
      ModelWrenchJacobians J;
      model.EvaluateWrench(states.At(i), values, p_BBcm.row(i).transpose(), &f_B, &tau_Bcm_B,
                           derivatives ? &J : nullptr);
      force.Set(i, f_B.transpose());
      torque.Set(i, tau_Bcm_B.transpose());
      if (!derivatives) continue;
      d_state.Set(i, J.d_state);
      d_values.Set(i, J.d_values);
      d_p_BBcm.Set(i, J.d_p_BBcm);
    }
  }
  py::dict found;
  found["f_B"] = force.array();
  found["tau_Bcm_B"] = torque.array();
  if (derivatives) {
    found["d_state"] = d_state.array();
    found["d_values"] = d_values.array();
    found["d_p_BBcm"] = d_p_BBcm.array();
  }
  return found;
}

/// {effect: (force, torque)}, each n×1×3.
py::dict EffectWrenchesAt(const DynamicModel& model, const States& states,
                          const Eigen::VectorXd& values, const ConstRows& p_BBcm) {
  std::vector<std::string> names;
  std::vector<Stack> force, torque;
  for (int i = 0; i < model.num_effects(); ++i) {
    if (!model.effect(i).adds_wrench()) continue;
    names.push_back(model.effect(i).name());
    force.emplace_back(states.size(), 1, 3);
    torque.emplace_back(states.size(), 1, 3);
  }
  {
    const py::gil_scoped_release release;
    for (Eigen::Index i = 0; i < states.size(); ++i) {
      const std::vector<EffectWrench> wrenches =
          model.EvaluateEffects(states.At(i), values, p_BBcm.row(i).transpose());
      for (size_t e = 0; e < wrenches.size(); ++e) {
        force[e].Set(i, wrenches[e].f_B.transpose());
        torque[e].Set(i, wrenches[e].tau_Bcm_B.transpose());
      }
    }
  }
  py::dict found;
  for (size_t e = 0; e < names.size(); ++e) {
    found[py::str(names[e])] = py::make_tuple(force[e].array(), torque[e].array());
  }
  return found;
}

py::dict PropertiesAt(const DynamicModel& model, const Eigen::VectorXd& values, double time_s) {
  BodyPropertiesJacobian J;
  const BodyProperties body = model.Properties(values, &J, time_s);
  py::dict found;
  found["mass_kg"] = body.mass;
  found["p_BBcm"] = body.p_BBcm;
  found["I_BBcm_B"] = RowMatrix(body.I_BBcm_B);
  found["g_W"] = body.g_W;
  found["wind_W"] = body.wind_W;
  found["p_BS"] = body.p_BS;
  found["R_BS"] = RowMatrix(body.R_BS);
  found["p_BI"] = body.p_BI;
  found["R_BI"] = RowMatrix(body.R_BI);
  found["d_values"] = RowMatrix(J);
  return found;
}

RowMatrix HubsOf(const Vehicle& vehicle) {
  RowMatrix hubs(vehicle.num_rotors(), 3);
  for (int i = 0; i < vehicle.num_rotors(); ++i) hubs.row(i) = vehicle.rotors[i].p_BP.transpose();
  return hubs;
}

Eigen::VectorXd SpinsOf(const Vehicle& vehicle) {
  Eigen::VectorXd spins(vehicle.num_rotors());
  for (int i = 0; i < vehicle.num_rotors(); ++i) spins[i] = vehicle.rotors[i].spin;
  return spins;
}

Vehicle Choose(const Vehicle& vehicle, const std::vector<std::string>& effects,
               const std::vector<std::string>& without, const std::vector<std::string>& free,
               const std::vector<std::string>& freeze,
               const std::optional<ParameterSet>& parameters) {
  ModelChoice choice;
  choice.effects = effects;
  choice.without = without;
  choice.free = free;
  choice.freeze = freeze;
  choice.parameters = parameters;
  return Configure(vehicle, choice);
}

py::list EstimatesOf(const ParameterSet& set) {
  py::list estimates;
  for (const ParameterEstimate& p : set.parameters) {
    py::dict entry;
    entry["name"] = p.full_name;
    entry["value"] = p.value;
    entry["sigma"] = p.estimated ? p.sigma : 0.0;
    entry["unit"] = p.unit;
    entry["estimated"] = p.estimated;
    entry["observable"] = p.observable;
    entry["scatter"] = p.scatter;
    estimates.append(entry);
  }
  return estimates;
}

/// The set's values for a model: where the set has none, what the model starts with.
Eigen::VectorXd ValuesFor(const DynamicModel& model, const ParameterSet& set) {
  Eigen::VectorXd values = model.InitialValues();
  for (int i = 0; i < model.num_parameters(); ++i) {
    const ParameterEstimate* found = set.Find(model.parameters()[i].full_name);
    if (found != nullptr) values[i] = found->value;
  }
  return values;
}

void BindVehicle(py::module_* m) {
  py::class_<Vehicle>(*m, "Vehicle")
      .def_readonly("name", &Vehicle::name)
      .def_readonly("mass_kg", &Vehicle::mass_kg)
      .def_readonly("gravity_m_s2", &Vehicle::gravity_m_s2)
      .def_property_readonly("inertia_kg_m2", [](const Vehicle& v) { return v.inertia_kg_m2; })
      .def_readonly("effects", &Vehicle::effects)
      .def_property_readonly("num_rotors", &Vehicle::num_rotors)
      .def_property_readonly("rotor_p_BP", &HubsOf)
      .def_property_readonly("rotor_spin", &SpinsOf)
      .def("choose", &Choose, py::arg("effects"), py::arg("without"), py::arg("free"),
           py::arg("freeze"), py::arg("parameters"));
  m->def("load_vehicle", &LoadVehicle, py::arg("file"));
  m->def("nominal_vehicle", &tools::NominalVehicle);
  m->def("effects", &EffectsFor, py::arg("vehicle"));
}

void BindParameters(py::module_* m) {
  py::class_<ParameterSet>(*m, "ParameterSet")
      .def_readonly("effects", &ParameterSet::effects)
      .def_readonly("provenance", &ParameterSet::provenance)
      .def_property_readonly("estimates", &EstimatesOf)
      .def_property_readonly("covariance",
                             [](const ParameterSet& s) { return RowMatrix(s.covariance); })
      .def("save", [](const ParameterSet& s, const std::string& file) { SaveParameters(s, file); })
      .def("text", &FormatParameters);
  m->def("load_parameters", &LoadParameters, py::arg("file"));
}

}  // namespace

void BindModel(py::module_* m) {
  BindVehicle(m);
  BindParameters(m);
  py::class_<States>(*m, "States")
      .def(py::init([](const Eigen::VectorXd& time_s, const RowMatrix& R_WB, const RowMatrix& p_WB,
                       const RowMatrix& v_AB_B, const RowMatrix& w_WB_B, const RowMatrix& speed,
                       const RowMatrix& speed_squared, const RowMatrix& acceleration,
                       const RowMatrix& speed_squared_rate, const RowMatrix& load_pull_W) {
        return States{time_s,        R_WB,         p_WB,
                      v_AB_B,        w_WB_B,       speed,
                      speed_squared, acceleration, speed_squared_rate,
                      load_pull_W};
      }));
  py::class_<DynamicModel>(*m, "DynamicModel")
      .def(py::init([](const Vehicle& vehicle) {
             return std::make_unique<DynamicModel>(vehicle, vehicle.effects);
           }),
           py::arg("vehicle"))
      .def_property_readonly("effect_names", &DynamicModel::effect_names)
      .def_property_readonly("parameters", &ModelParametersOf)
      .def_property_readonly(
          "initial_values",
          [](const DynamicModel& d) { return Eigen::VectorXd(d.InitialValues()); })
      .def_property_readonly("varies", &DynamicModel::varies)
      .def("values_of", &ValuesFor, py::arg("parameters"))
      .def("wrench", &WrenchAt, py::arg("states"), py::arg("values"), py::arg("p_BBcm"),
           py::arg("derivatives"))
      .def("effect_wrenches", &EffectWrenchesAt, py::arg("states"), py::arg("values"),
           py::arg("p_BBcm"))
      .def("properties", &PropertiesAt, py::arg("values"), py::arg("time_s"));
}

}  // namespace odmc::python
