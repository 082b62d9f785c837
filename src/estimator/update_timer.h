#pragma once

#include <chrono>
#include <ctime>
#include <functional>

namespace odmc {

/// Processor time of this thread [s].
inline double ThreadCpuSeconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Times one update on both clocks, stage by stage.
class UpdateTimer {
 public:
  UpdateTimer() : stage_(Clock::now()), cpu_(ThreadCpuSeconds()) {}

  /// Ends a stage; the next one begins. @returns its wall time
  double EndStageMs() {
    const Clock::time_point now = Clock::now();
    const double ms = 1e3 * std::chrono::duration<double>(now - stage_).count();
    stage_ = now;
    wall_ms_ += ms;
    return ms;
  }

  /// Runs, between two stages, what does not count.
  void RunUntimed(const std::function<void()>& run) {
    const double cpu = ThreadCpuSeconds();
    run();
    cpu_ += ThreadCpuSeconds() - cpu;
    stage_ = Clock::now();
  }

  double WallMs() const { return wall_ms_; }  // of the stages that have ended
  double CpuMs() const { return 1e3 * (ThreadCpuSeconds() - cpu_); }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point stage_;
  double wall_ms_ = 0.0, cpu_;
};

}  // namespace odmc
