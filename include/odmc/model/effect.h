#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "odmc/model/body_properties.h"
#include "odmc/model/effect_traits.h"
#include "odmc/model/flight_state.h"
#include "odmc/model/parameter.h"
#include "odmc/model/wrench.h"

namespace odmc {

/// Values of one effect's parameters, own ones first, then borrowed ones [their units].
using ParameterValues = Eigen::Ref<const Eigen::VectorXd>;

/// Derivative of BodyProperties with respect to one effect's parameters (28×n), wherever it lies.
using BodyPropertyJacobian =
    Eigen::Map<Eigen::Matrix<double, kNumBodyPropertyRows, Eigen::Dynamic>>;

/// What an effect is, in words: printed by `--help`, the report and the documentation.
struct EffectDescription {
  std::string name;      ///< as in YAML, "drag"
  std::string title;     ///< "Linear drag"
  std::string formula;   ///< plain text, "f = diag(d) v_AB_B at Bcm"
  std::string source;    ///< "model.md 2; paper Eq. (1)"
  std::string validity;  ///< where it stops being true
  /// Takes rotor speeds' rates, which are noisy: the dynamics factor accounts for it.
  bool from_rotor_rates = false;
};

/// One physical effect: reads the flight state and adds its wrench on the body, or shapes the body
/// itself. Holds no estimate; the values of its parameters are passed in.
class Effect {
 public:
  virtual ~Effect() = default;

  const EffectDescription& description() const { return description_; }
  const std::string& name() const { return description_.name; }

  /// Name, unit, start value and prior of each own parameter, in order.
  const std::vector<ParameterSpec>& parameters() const { return parameters_; }

  /// Full names ("thrust.k_f") of other effects' parameters this effect reads. Their values follow
  /// the own ones; where such an effect is absent, its prior value is used.
  const std::vector<std::string>& borrowed() const { return borrowed_; }

  /// Own and borrowed parameters together.
  int num_values() const { return static_cast<int>(parameters_.size() + borrowed_.size()); }

  /// True if the effect adds forces or couples (false if it only shapes the body).
  virtual bool adds_wrench() const { return true; }
  /// True if the effect shapes the body.
  virtual bool shapes_body() const { return !adds_wrench(); }
  /// Where it shapes the body: the rows its derivative may fill. Fewer make the estimator faster.
  virtual BodyPropertyRows shaped_rows() const { return {0, kNumBodyPropertyRows}; }
  /// True if it changes what a sensor sees of a motion, and no force: what its parameters do
  /// follows from the measured motion alone, whatever the rotors and the air do.
  virtual bool is_kinematic() const { return false; }
  /// Name of the own parameter that is the time from which on the effect acts [s], and before which
  /// it does nothing; empty: it acts throughout.
  virtual std::string onset_parameter() const { return ""; }
  /// True if the body it shapes changes with time.
  virtual bool depends_on_time() const { return false; }
  /// True if its parameters are those of a flight (the wind that day), not of the vehicle: many
  /// flights together share nothing of it.
  virtual bool belongs_to_flight() const { return false; }
  /// True if what people change between flights changes it: a battery, a load, a propeller. News of
  /// its parameters are looked for in a vehicle's history first.
  virtual bool changes_between_flights() const { return false; }

  // What attribution needs to know of it. By default: one candidate, without settings.

  /// The ways to try the effect on a flight whose model lacks it; empty where it cannot be told
  /// there, or never (the base of every model).
  /// @param fits_thrust true if the model estimates the thrust coefficient
  virtual std::vector<EffectTrial> Trials(const FlownRange& flown, bool fits_thrust) const;
  /// How the settings of a trial are refined, one after the other.
  virtual std::vector<SettingRefinement> refinements() const { return {}; }
  /// What tells it from other effects. One of the two says it.
  virtual std::vector<DistinguishingManoeuvre> distinguishing_manoeuvres() const { return {}; }
  /// Name of the own parameter that is a mass carried along [kg]; empty: none.
  virtual std::string added_mass_parameter() const { return ""; }
  /// What follows from its parameters and says more than these.
  /// @param own values of parameters()
  virtual std::vector<DerivedFigure> DerivedFigures(const Eigen::VectorXd& own) const;
  /// Its internal state, where it is a pendulum: indices in parameters().
  virtual std::optional<PendulumParameters> pendulum() const { return std::nullopt; }

  /// Standard deviation of the first own parameter on recordings on which nothing is out of the
  /// ordinary: so much of the effect is warned of, and not named. 0: any of it is named.
  virtual double ordinary_sigma() const { return 0.0; }

  /// What to fly so that a flight shows own parameter `k`, after "fly": "forward and back at
  /// several speeds".
  virtual std::string manoeuvre(size_t k) const;

  // What test flights with it need (simulate_undeclared). By default: sizes and signs at random
  // about the priors' sigmas.

  /// Names of the trajectories that show it, best first; empty: no test flights are made with it.
  virtual std::vector<std::string> shown_by() const { return {"aggressive", "octo"}; }
  /// Values of parameters() at a natural size, with signs and a shape drawn at random.
  virtual Eigen::VectorXd Draw(const NormalNumbers& normal) const;
  /// Moves what was drawn to where a flight takes place.
  /// @param lowest_m lowest point flown, in the odometry's world
  virtual void Place(double lowest_m, Eigen::VectorXd* values) const;
  /// Names of the own parameters that scale the effect together; empty: all of them do.
  virtual std::vector<std::string> size_parameters() const { return {}; }

  /// Adds this effect's forces (with the point they act at) and couples, in B, to `wrench`. If `J`
  /// is given, adds the derivatives by state and parameters to it.
  /// @pre values.size() == num_values()
  void AddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                 WrenchJacobians* J = nullptr) const;

  /// Changes what it shapes in `body`, `time_s` after the flight's start. If `J` is given
  /// (28×num_values()), sets what is not zero of it.
  /// @pre values.size() == num_values(); `J` is zero
  void Shape(double time_s, const ParameterValues& values, BodyProperties* body,
             BodyPropertyJacobian* J = nullptr) const;

 protected:
  Effect(const Vehicle& vehicle, EffectDescription description,
         std::vector<ParameterSpec> parameters, std::vector<std::string> borrowed = {});

  const Vehicle& vehicle() const { return vehicle_; }

 private:
  virtual void DoAddWrench(const FlightState& state, const ParameterValues& values, Wrench* wrench,
                           WrenchJacobians* J) const;
  virtual void DoShape(const ParameterValues& values, BodyProperties* body,
                       BodyPropertyJacobian* J) const;
  /// For effects that depend on time; calls DoShape() for the others.
  virtual void DoShapeAt(double time_s, const ParameterValues& values, BodyProperties* body,
                         BodyPropertyJacobian* J) const;

  Vehicle vehicle_;
  EffectDescription description_;
  std::vector<ParameterSpec> parameters_;
  std::vector<std::string> borrowed_;
};

/// Names and constructors of every effect. Filled by one explicit function, RegisterAllEffects().
class EffectRegistry {
 public:
  using Factory = std::function<std::unique_ptr<Effect>(const Vehicle&)>;

  void Add(const std::string& name, Factory factory);
  bool Has(const std::string& name) const;
  /// @throws std::invalid_argument naming the effect and the known ones if it is unknown.
  std::unique_ptr<Effect> Make(const std::string& name, const Vehicle& vehicle) const;
  /// In the order of registration.
  const std::vector<std::string>& names() const { return names_; }

  /// The registry with every effect of this package (effects/register.cpp), and those of Extend().
  static const EffectRegistry& Default();
  /// Adds an effect from outside this package to Default(): then vehicle files may name it,
  /// attribution tries it and test flights are made with it. Call it first thing in main(), before
  /// there are threads.
  /// @throws std::invalid_argument if the name is taken
  static void Extend(const std::string& name, Factory factory);

 private:
  static EffectRegistry& Shared();

  std::vector<std::string> names_;
  std::vector<Factory> factories_;
};

/// Registers every effect of this package: one line each. Defined in effects/register.cpp.
void RegisterAllEffects(EffectRegistry* registry);

}  // namespace odmc
