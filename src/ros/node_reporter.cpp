#include "odmc/ros/node_reporter.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <ros/init.h>
#include <ros/this_node.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/image_encodings.h>

#include <chrono>
#include <utility>

#include "odmc/text/format.h"

namespace odmc {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kPeriod(500);  // image; diagnostics every other time

sensor_msgs::Image ToMessage(const cv::Mat& image) {
  sensor_msgs::Image m;
  m.header.stamp = ros::Time::now();
  m.height = static_cast<std::uint32_t>(image.rows);
  m.width = static_cast<std::uint32_t>(image.cols);
  m.encoding = sensor_msgs::image_encodings::BGR8;
  m.step = static_cast<std::uint32_t>(image.cols * image.elemSize());
  m.data.assign(image.datastart, image.dataend);
  return m;
}

LiveImageTexts TextsOf(const NodeStatus& status, const std::string& vehicle) {
  LiveImageTexts texts;
  texts.title = vehicle;
  texts.good = status.accepted;
  texts.status = !status.fatal.empty() ? "stopped"
                 : !status.airborne    ? "on the ground"
                 : status.accepted     ? "airborne, accepted"
                                       : "airborne";
  texts.details = Format("%.1f s   residual %.3g N, %.2g N m   update %.1f ms (p99 %.1f)",
                         status.time_s, status.residual_force_rms_N, status.residual_torque_rms_Nm,
                         status.update_ms_median, status.update_ms_p99);
  texts.warnings = status.unphysical;
  if (status.rotors) {
    const std::vector<std::string> bad = status.rotors->Sentences();
    texts.warnings.insert(texts.warnings.end(), bad.begin(), bad.end());
  }
  texts.warnings.insert(texts.warnings.end(), status.warnings.begin(), status.warnings.end());
  return texts;
}

}  // namespace

NodeReporter::NodeReporter(ros::NodeHandle node, std::string vehicle, bool always_draw,
                           Guarded<SharedStatus>* shared, InputQueue* queue)
    : vehicle_(std::move(vehicle)),
      always_draw_(always_draw),
      shared_(shared),
      queue_(queue),
      diagnostics_(node.advertise<diagnostic_msgs::DiagnosticArray>("/diagnostics", 10)),
      image_(node.advertise<sensor_msgs::Image>("live_image", 1)),
      thread_(&NodeReporter::Run, this) {}

void NodeReporter::Join() {
  if (thread_.joinable()) thread_.join();
}

void NodeReporter::Run() {
  Clock::time_point last_report = Clock::now();
  InputQueue::Look before;
  for (bool odd = false; !queue_->SleepUnlessStopping(kPeriod); odd = !odd) {
    PublishLiveImage();
    if (!odd) continue;
    const Clock::time_point time = Clock::now();
    const InputQueue::Look now = queue_->Snapshot();
    PublishDiagnostics(now, before, std::chrono::duration<double>(time - last_report).count());
    before = now;
    last_report = time;
  }
}

void NodeReporter::PublishDiagnostics(const InputQueue::Look& now, const InputQueue::Look& before,
                                      double seconds) {
  if (!ros::ok()) return;
  NodeStatus status = shared_->With([](SharedStatus* s) { return s->status; });
  status.queued = now.queued;
  diagnostic_msgs::DiagnosticArray message;
  message.header.stamp = ros::Time::now();
  const std::string name = ros::this_node::getName();
  message.status.push_back(EstimatorDiagnostic(status, name + ": estimator"));
  message.status.push_back(UnexplainedDiagnostic(status, name + ": unexplained"));
  if (status.rotors) message.status.push_back(RotorDiagnostic(*status.rotors, name + ": rotors"));
  message.status.push_back(
      InputDiagnostic(now.streams, before.streams, seconds, name + ": inputs"));
  diagnostics_.publish(message);
}

void NodeReporter::PublishLiveImage() {
  if (!ros::ok()) return;
  if (!always_draw_ && image_.getNumSubscribers() == 0) return;
  const SharedStatus seen = shared_->Get();
  if (seen.status.model == nullptr) return;
  image_.publish(ToMessage(DrawLiveImage(*seen.status.model, seen.history, seen.status.observable,
                                         TextsOf(seen.status, vehicle_))));
}

}  // namespace odmc
