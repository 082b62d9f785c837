#pragma once

#include <Eigen/Core>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "odmc/attribution/close_loop.h"
#include "odmc/sensing/samples.h"

namespace odmc {

/// When a flight's residual is looked at. What counts as structure and as a find is as in
/// CloseLoopOptions.
struct ResidualWatchOptions {
  double residual_watch_period_s = 5.0;   ///< flight time between two looks [s]; 0: never
  double residual_watch_window_s = 20.0;  ///< flight time looked at [s], 10 to 120
  int residual_watch_confirmations = 3;   ///< looks in a row that must find the same effect, >= 1

  template <typename Visitor>
  void Visit(Visitor* v) {
    v->Field("residual_watch_period_s", &residual_watch_period_s);
    v->Field("residual_watch_window_s", &residual_watch_window_s);
    v->Field("residual_watch_confirmations", &residual_watch_confirmations);
  }

  bool IsValid(std::string* error) const;
};

/// What the newest seconds of a flight leave unexplained. All numbers are finite.
struct ResidualAnalysis {
  Stamp stamp = 0;        ///< newest odometry looked at
  double flight_s = 0.0;  ///< airborne time looked at [s]
  std::shared_ptr<const DynamicModel> model;
  double structured_share = 0.0;  ///< of the variance of the most structured channel, 0 to 1
  std::string channel;            ///< that channel, as "force_x"
  double whiteness_p = 1.0;       ///< chance of such structure in noise, smallest of the channels
                                  ///< times their number
  bool structured = false;        ///< some channel is: p and share beyond CloseLoopOptions'
  Eigen::Vector3d force_rmse_N = Eigen::Vector3d::Zero();    ///< body axes
  Eigen::Vector3d torque_rmse_Nm = Eigen::Vector3d::Zero();  ///< body axes; 0 without torque
  std::optional<RankedEffect> candidate;   ///< the effect that would explain it, if any
  double explained_share = 0.0;            ///< of the structured variance that it and `beside` take
  std::vector<std::string> beside;         ///< further effects that act
  std::vector<std::string> alternatives;   ///< candidates these seconds can't tell from it
  int in_a_row = 0;                        ///< looks that found this candidate, this one counted
  std::map<std::string, double> refitted;  ///< the model's values beside the candidate
};

/// Online counterpart of CloseLoop()'s choice: keeps the newest seconds of a flight and says what
/// the present model leaves unexplained of them and which one effect would explain it. The residual
/// is that of the model refitted to these seconds from the present estimate, so that what the
/// estimator has yet to learn does not count. Gusts are not looked for.
///
/// One thread may feed it while another one looks; feeding never waits for a look.
class ResidualWatch {
 public:
  /// @param file_vehicle as the estimator has it: nominal inertia, mounts
  /// @throws std::invalid_argument if the options are not valid
  ResidualWatch(const Vehicle& file_vehicle, const ResidualWatchOptions& options, bool with_torque);

  // The feeding thread.
  void Add(const OdometrySample& sample) { Put(sample); }
  void Add(const ImuSample& sample) { Put(sample); }
  void Add(const RotorSample& sample) { Put(sample); }
  void Add(const BatterySample&) {}
  /// Whether the vehicle flew at a keyframe; what lies on the ground is left out.
  void SetAirborne(Stamp keyframe, bool airborne);
  /// The model and its values as of now. Effects that depend on time count from `start`.
  void SetEstimate(std::shared_ptr<const DynamicModel> model, const ModelValues& values,
                   Stamp start);
  /// The clock stepped back: forgets all samples.
  void Clear();

  // The looking thread.
  /// Looks if it is time to, the vehicle flies, and enough of the flight is there; else empty.
  /// Takes seconds.
  /// @param give_up asked now and then; true ends the look without a result
  std::optional<ResidualAnalysis> Look(const std::function<bool()>& give_up = {});
  /// Samples that are kept. Not while another thread looks.
  size_t size() const;

 private:
  struct Keyframe {
    Stamp stamp;
    bool airborne;
  };
  using Item = std::variant<OdometrySample, ImuSample, RotorSample, Keyframe>;
  struct Estimate {
    std::shared_ptr<const DynamicModel> model;
    ModelValues values;
    Stamp start = 0;
  };

  static Stamp StampOf(const Item& item);
  void Put(Item item);
  std::optional<Estimate> TakeIn();
  void Keep(const Keyframe& keyframe);
  void ForgetBefore(Stamp stamp);
  /// As the estimator mends it: glitches, dropouts.
  FlightLog MendedLog() const;
  /// Of the log's first odometry sample on the estimate's clock [s].
  double OffsetTo(Stamp start) const;
  ThinnedFlight Flight(const FlightLog& mended, Stamp start) const;
  /// @param halved WithEverySecondRotorSample()
  ResidualAnalysis Examine(const ThinnedFlight& flight, const std::optional<ThinnedFlight>& halved,
                           const Estimate& estimate, const std::function<bool()>& give_up);

  const Vehicle file_vehicle_;
  const ResidualWatchOptions options_;
  const bool with_torque_;
  const AttributionOptions decision_;

  // Between the threads.
  mutable std::mutex mutex_;
  std::deque<Item> inbox_;
  std::optional<Estimate> newest_estimate_;
  std::optional<Stamp> next_look_;
  bool cleared_ = false, airborne_ = false;

  // The looking thread's.
  FlightLog log_;
  std::vector<std::pair<Stamp, Stamp>> ground_spans_;
  std::optional<Keyframe> last_keyframe_;
  std::string last_candidate_;
  std::shared_ptr<const DynamicModel> last_model_;
  int in_a_row_ = 0;
};

/// Start values and priors for an estimator that carries on with the effect that was found.
/// Parameters start where they are, with their present sigma, widened by what the effect moves them
/// (they have made up for it); the effect's own start at what the look estimated, with the sigmas
/// of the vehicle file or the catalogue.
/// @param extended the vehicle with the effect, see VehicleWith()
/// @param present the newest estimate of `found.model`
Vehicle WarmStarted(const Vehicle& extended, const ParameterSet& present,
                    const ResidualAnalysis& found);

}  // namespace odmc
