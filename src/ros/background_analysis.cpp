#include "odmc/ros/background_analysis.h"

#include <ros/console.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <utility>

#include "odmc/analysis/calibration.h"
#include "odmc/analysis/ground_spans.h"
#include "odmc/inspection/recording_inspection.h"

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kIdle(200);
constexpr int kNiceness = 10;
constexpr double kDoubted_s = 20.0;  // of flight that is replayed without each doubt

bool HoldsReaction(const DynamicModel& model) {
  const int k = model.IndexOf("rotor_torque.k_m");
  return k >= 0 && !model.parameters()[k].estimated;
}

}  // namespace

BackgroundAnalysis::BackgroundAnalysis(const EstimatorOptions& estimator,
                                       std::function<void(const ResidualAnalysis&)> on_look,
                                       InputQueue* queue)
    : estimator_(estimator), on_look_(std::move(on_look)), queue_(queue) {
  estimator_.num_threads = 1;
  thread_ = std::thread(&BackgroundAnalysis::Run, this);
}

void BackgroundAnalysis::Join() {
  if (thread_.joinable()) thread_.join();
}

void BackgroundAnalysis::Watch(std::shared_ptr<ResidualWatch> watch) {
  shared_.With([&](Shared* s) { s->watch = std::move(watch); });
}

std::shared_ptr<ResidualWatch> BackgroundAnalysis::watch() {
  return shared_.With([](Shared* s) { return s->watch; });
}

void BackgroundAnalysis::Inspect(StreamsSeen seen) {
  shared_.With([&](Shared* s) { s->seen = std::move(seen); });
}

std::optional<BackgroundAnalysis::StreamsFound> BackgroundAnalysis::TakeInspection() {
  std::optional<StreamsFound> found;
  shared_.TryWith([&](Shared* s) { found.swap(s->found); });
  return found;
}

std::optional<ResidualAnalysis> BackgroundAnalysis::TakeProposal() {
  return shared_.With([](Shared* s) { return std::exchange(s->proposal, std::nullopt); });
}

void BackgroundAnalysis::Propose(const ResidualAnalysis& look) {
  shared_.With([&](Shared* s) { s->proposal = look; });
}

void BackgroundAnalysis::Run() {
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), kNiceness);
  while (!queue_->SleepUnlessStopping(kIdle)) {
    InspectIfDue();
    const std::shared_ptr<ResidualWatch> looking = watch();
    if (!looking) continue;
    try {
      const std::optional<ResidualAnalysis> look =
          looking->Look([this] { return queue_->stopping(); });
      if (look) on_look_(*look);
    } catch (const std::exception& e) {
      ROS_ERROR_THROTTLE(10.0, "the residual cannot be looked at: %s", e.what());
    }
  }
}

TorqueBands BackgroundAnalysis::BandsOf(const StreamsSeen& seen) {
  if (!seen.values || !HoldsReaction(*seen.model)) return {};
  const GroundSpans ground = FindGroundSpans(seen.log, *seen.model, *seen.values);
  return FindTorqueBands(seen.log, *seen.model, *seen.values, seen.k_f_sigma, ground.spans);
}

void BackgroundAnalysis::InspectIfDue() {
  std::optional<StreamsSeen> seen =
      shared_.With([](Shared* s) { return std::exchange(s->seen, std::nullopt); });
  if (!seen) return;
  try {
    StreamsFound found;
    found.inspection = InspectRecording(seen->vehicle, &seen->log);
    found.model = seen->model;
    const Stamp from =
        seen->log.odometry.empty() ? 0 : seen->log.odometry.back().stamp - FromSeconds(kDoubted_s);
    // Of low priority, on a busy machine, this could hold the node's end up for half a minute.
    const auto give_up = [this] { return queue_->stopping(); };
    found.changes = ChangesWithout(found.inspection.doubts, seen->log, from, *seen->model,
                                   estimator_, nullptr, give_up);
    if (give_up()) return;
    found.bands = BandsOf(*seen);
    if (give_up()) return;
    shared_.With([&](Shared* s) { s->found = std::move(found); });
  } catch (const std::exception& e) {
    ROS_ERROR_THROTTLE(10.0, "the streams cannot be compared: %s", e.what());
  }
}

}  // namespace odmc
