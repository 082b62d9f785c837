#include "odmc/ros/input_queue.h"

#include <algorithm>
#include <iterator>

namespace odmc {
namespace {

constexpr std::chrono::milliseconds kIdle(100);
constexpr size_t kBatch = 300;  // samples taken from the queue at once

}  // namespace

void InputQueue::Push(InputStream stream, std::vector<InputSample> inputs) {
  const std::lock_guard<std::mutex> lock(mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  for (InputSample& input : inputs) {
    if (queue_.size() >= capacity_) {
      ++status.overflowed;
    } else {
      queue_.push_back(std::move(input));
      input_came_.notify_one();
    }
  }
}

void InputQueue::Refuse(InputStream stream, const std::string& refusal) {
  const std::lock_guard<std::mutex> lock(mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  ++status.refused;
  status.refusal = refusal;
}

void InputQueue::CountPassedOver(InputStream stream) {
  const std::lock_guard<std::mutex> lock(mutex_);
  StreamStatus& status = streams_[static_cast<size_t>(stream)];
  ++status.received;
  ++status.passed_over;
}

void InputQueue::NoteStamps(InputStream stream, const std::string& stamps) {
  const std::lock_guard<std::mutex> lock(mutex_);
  streams_[static_cast<size_t>(stream)].stamps = stamps;
}

void InputQueue::NoteRefusal(InputStream stream, const std::string& refusal) {
  const std::lock_guard<std::mutex> lock(mutex_);
  streams_[static_cast<size_t>(stream)].refusal = refusal;
}

InputQueue::Answer InputQueue::Ask(std::function<Answer()> act) {
  std::packaged_task<Answer()> task(std::move(act));
  std::future<Answer> answer = task.get_future();
  uint64_t number = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    number = ++requests_made_;
    requests_.push_back({number, std::move(task)});
  }
  input_came_.notify_one();
  if (answer.wait_for(patience_) != std::future_status::ready) {
    return {false, Withdraw(number) ? "the estimator does not answer; nothing was done"
                                    : "the estimator is still at it"};
  }
  try {
    return answer.get();
  } catch (const std::exception& e) {
    return {false, e.what()};
  }
}

bool InputQueue::Withdraw(uint64_t number) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto at = std::find_if(requests_.begin(), requests_.end(),
                               [number](const Request& r) { return r.number == number; });
  if (at == requests_.end()) return false;
  requests_.erase(at);
  return true;
}

InputQueue::Look InputQueue::Snapshot() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return {streams_, queue_.size()};
}

void InputQueue::Stop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopping_ = true;
    stopped_at_ = std::chrono::steady_clock::now();
  }
  input_came_.notify_all();
  stops_.notify_all();
}

bool InputQueue::stopping() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return stopping_;
}

bool InputQueue::StoppedBefore(std::chrono::milliseconds patience) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return stopping_ && std::chrono::steady_clock::now() > stopped_at_ + patience;
}

bool InputQueue::SleepUnlessStopping(std::chrono::milliseconds period) {
  std::unique_lock<std::mutex> lock(mutex_);
  return stops_.wait_for(lock, period, [this] { return stopping_; });
}

bool InputQueue::WaitForInput(std::deque<InputSample>* batch) {
  {
    std::unique_lock<std::mutex> lock(mutex_);
    input_came_.wait_for(lock, kIdle,
                         [this] { return stopping_ || !queue_.empty() || !requests_.empty(); });
    if (stopping_) return false;
  }
  TakeBatch(batch);
  return true;
}

bool InputQueue::TakeBatch(std::deque<InputSample>* batch) {
  const std::lock_guard<std::mutex> lock(mutex_);
  // Not all at once: a long batch would hide the queue's length and delay the end.
  const auto end = queue_.begin() + static_cast<std::ptrdiff_t>(std::min(queue_.size(), kBatch));
  batch->assign(std::make_move_iterator(queue_.begin()), std::make_move_iterator(end));
  queue_.erase(queue_.begin(), end);
  return !batch->empty();
}

void InputQueue::AnswerRequests() {
  for (;;) {
    std::packaged_task<Answer()> task;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (requests_.empty()) return;
      task = std::move(requests_.front().task);
      requests_.pop_front();
    }
    task();
  }
}

}  // namespace odmc
