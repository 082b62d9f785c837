#pragma once

#include <array>
#include <vector>

#include "odmc/window/window.h"

namespace odmc {

/// The variables of a window and where they are linearized, to solve it more than once from the
/// same point. The window must still have the same keyframes and factors when it is restored.
class SavedWindow {
 public:
  explicit SavedWindow(const Window& window)
      : eta_(window.eta()),
        biases_(window.biases()),
        prior_(window.prior()),
        anchor_(window.anchor()) {
    for (const Keyframe& k : window.keyframes()) keyframes_.push_back({k.x, k.x_lin, k.in_prior});
  }

  void Restore(Window* window) const {
    window->eta() = eta_;
    window->biases() = biases_;
    window->prior() = prior_;
    window->anchor() = anchor_;
    for (size_t i = 0; i < keyframes_.size(); ++i) {
      Keyframe& keyframe = window->keyframes()[i];
      keyframe.x = keyframes_[i].x;
      keyframe.x_lin = keyframes_[i].x_lin;
      keyframe.in_prior = keyframes_[i].in_prior;
    }
  }

  const ParameterVector& eta() const { return eta_; }

 private:
  struct OfKeyframe {
    std::array<double, kStateSize> x, x_lin;
    bool in_prior;
  };
  ParameterVector eta_;
  Ring<Bias> biases_;
  Prior prior_;
  double anchor_;
  std::vector<OfKeyframe> keyframes_;
};

}  // namespace odmc
