#include "odmc/sim/disturbance.h"

#include <cmath>

#include "odmc/sim/random_streams.h"

namespace odmc {
namespace {

constexpr double kPeriod_s = 0.01;
constexpr double kNominalWeight_N = 0.75 * 9.81;  // of the vehicle of model.md section 8
constexpr double kNominalArm_m = 0.14534;

long PeriodAt(double time_s) { return static_cast<long>(std::floor(time_s / kPeriod_s + 1e-6)); }

}  // namespace

Disturbance::Disturbance(const Vehicle& vehicle, double force_N, double torque_Nm, int seed)
    : random_(seed, kDisturbanceStream) {
  const double weight = vehicle.mass_kg * vehicle.gravity_m_s2 / kNominalWeight_N;
  force_ = force_N * weight;
  torque_ = torque_Nm * weight * vehicle.ArmLength() / kNominalArm_m;
}

const BodyWrench& Disturbance::At(double time_s) {
  for (const long period = PeriodAt(time_s); period_ < period; ++period_) {
    wrench_.f_B = force_ * random_.Next3();
    wrench_.tau_Bcm_B = torque_ * random_.Next3();
  }
  return wrench_;
}

VaryingParameters::VaryingParameters(const DynamicModel& model, const ModelValues& values, int seed)
    : model_(&model), values_(values), random_(seed, kProcessStream) {}

void VaryingParameters::Apply(double time_s, RigidBody* body) {
  const long period = PeriodAt(time_s);
  if (!model_->varies() || period == period_) return;
  for (; period_ < period; ++period_) {
    for (const DynamicModel::ProcessParameter& p : model_->processes()) {
      const bool first = period_ < 0;
      const double decay = first ? 0.0 : std::exp(-kPeriod_s / values_[p.time_constant]);
      values_[p.index] = decay * values_[p.index] +
                         values_[p.sigma] * std::sqrt(1.0 - decay * decay) * random_.Next();
    }
  }
  body->Vary(values_, time_s);
}

}  // namespace odmc
