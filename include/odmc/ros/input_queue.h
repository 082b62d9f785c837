#pragma once

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <future>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "odmc/ros/node_status.h"
#include "odmc/ros/streams.h"

namespace odmc {

/// What topics and services bring, for the one thread that estimates, with its counts by topic; and
/// the sign to stop, for all threads. Every member is under one lock.
class InputQueue {
 public:
  /// What a service has to say: whether it worked, and a sentence.
  using Answer = std::pair<bool, std::string>;
  using Streams = std::array<StreamStatus, kNumInputStreams>;
  struct Look {
    Streams streams;
    size_t queued = 0;
  };

  /// @param capacity samples that wait, at most
  /// @param patience how long Ask() waits for its answer
  explicit InputQueue(int capacity, std::chrono::milliseconds patience = std::chrono::seconds(5))
      : capacity_(static_cast<size_t>(capacity)), patience_(patience) {}

  /// Counts a message and queues what came of it.
  void Push(InputStream stream, std::vector<InputSample> inputs);
  /// Counts a message that can't be used. @param refusal why; may be empty
  void Refuse(InputStream stream, const std::string& refusal);
  /// Counts a message with nothing in it yet.
  void CountPassedOver(InputStream stream);
  void NoteStamps(InputStream stream, const std::string& stamps);
  void NoteRefusal(InputStream stream, const std::string& refusal);
  /// Has the estimator thread do it, between two batches of samples. What that thread has not begun
  /// when patience ends is not done any more.
  /// @returns what it answers; false, and whether it may still be done, where it does not in time
  Answer Ask(std::function<Answer()> act);
  Look Snapshot();

  void Stop();
  bool stopping();
  /// True once the sign to stop is older than `patience`.
  bool StoppedBefore(std::chrono::milliseconds patience);
  /// Sleeps for `period`, or until there is the sign to stop. @returns whether there is
  bool SleepUnlessStopping(std::chrono::milliseconds period);

  // The estimator thread.

  /// Waits a moment for input. @returns false once there is the sign to stop
  bool WaitForInput(std::deque<InputSample>* batch);
  /// @returns false if there is none
  bool TakeBatch(std::deque<InputSample>* batch);
  void AnswerRequests();

 private:
  struct Request {
    uint64_t number;
    std::packaged_task<Answer()> task;
  };

  /// @returns false if the estimator thread has it already
  bool Withdraw(uint64_t number);

  const size_t capacity_;
  const std::chrono::milliseconds patience_;
  std::mutex mutex_;
  std::condition_variable input_came_, stops_;
  std::deque<InputSample> queue_;
  std::deque<Request> requests_;
  uint64_t requests_made_ = 0;
  Streams streams_;
  bool stopping_ = false;
  std::chrono::steady_clock::time_point stopped_at_;
};

}  // namespace odmc
