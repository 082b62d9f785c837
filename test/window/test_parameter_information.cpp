#include <gtest/gtest.h>

#include <limits>

#include "odmc/window/marginalization.h"
#include "odmc/window/parameter_information.h"
#include "support/linear_window.h"

namespace odmc {
namespace test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kNoCaching = 1000;

class ParameterInformationTest : public testing::Test {
 protected:
  ParameterInformationTest()
      : model_(FourParameterModel()), layout_(model_, model_.InitialValues()) {}

  VectorXd Threshold(double value) const {
    return VectorXd::Constant(layout_.num_estimated(), value);
  }

  /// Schur complement of the whole window's normal equations, with the parameters' own priors.
  static MatrixXd Dense(const Window& window) {
    const int states = static_cast<int>(window.keyframes().size());
    const int biases = static_cast<int>(window.biases().size());
    MatrixXd H = MarginalOf(DenseNormal(window), Remaining(window, states, biases)).H;
    H.diagonal() += window.parameter_sigma().cwiseAbs2().cwiseInverse();
    return H;
  }

  static double Relative(const MatrixXd& a, const MatrixXd& b) { return (a - b).norm() / a.norm(); }

  DynamicModel model_;
  ParameterLayout layout_;
};

TEST_F(ParameterInformationTest, EqualsTheDenseSchurComplement) {
  for (const int per_bias : {0, 3}) {
    for (const int unlinked : {-1, 4}) {
      LinearWindowOptions options;
      options.keyframes = 9;
      options.keyframes_per_bias = per_bias;
      options.unlinked = unlinked;
      Window window(&layout_);
      LinearWindowMaker(&window, options, 3).Fill();
      ParameterInformation information(kNoCaching);
      EXPECT_LT(Relative(Dense(window), information.Update(window, Threshold(0.1))), 1e-9);
      for (int i = 0; i < 4; ++i) {
        MarginalizeOldest(&window, Threshold(0.1));
        EXPECT_LT(Relative(Dense(window), information.Update(window, Threshold(0.1))), 1e-9)
            << per_bias << " keyframes per bias, new chain at " << unlinked << ", after " << i + 1;
      }
    }
  }
}

TEST_F(ParameterInformationTest, EqualsItWithStatesNobodyMeasured) {
  LinearWindowOptions options;
  options.with_rotation = false;
  Window window(&layout_);
  LinearWindowMaker(&window, options, 5).Fill();
  ParameterInformation information(kNoCaching);
  EXPECT_LT(Relative(Dense(window), information.Update(window, Threshold(0.1))), 1e-8);
}

TEST_F(ParameterInformationTest, IsThePriorsAloneInAnEmptyWindow) {
  Window window(&layout_);
  ParameterInformation information;
  const MatrixXd expected = window.parameter_sigma().cwiseAbs2().cwiseInverse().asDiagonal();
  EXPECT_LT(Relative(expected, information.Update(window, Threshold(0.1))), 1e-15);
}

TEST_F(ParameterInformationTest, KeptPartsGiveTheSameWhileTheWindowSlides) {
  for (const int per_bias : {0, 7}) {
    LinearWindowOptions options;
    options.keyframes_per_bias = per_bias;
    Window window(&layout_);
    LinearWindowMaker maker(&window, options, 7);
    ParameterInformation information(4);
    for (int k = 0; k < 60; ++k) {
      maker.AddKeyframe();
      const MatrixXd got = information.Update(window, Threshold(0.1));
      EXPECT_LT(Relative(Dense(window), got), 1e-8) << "keyframe " << k;
      while (window.keyframes().size() > 20) MarginalizeOldest(&window, Threshold(0.1));
    }
  }
}

TEST_F(ParameterInformationTest, KeptPartsFollowAScaledPrior) {
  LinearWindowOptions options;
  options.keyframes = 20;
  Window window(&layout_);
  LinearWindowMaker maker(&window, options, 9);
  maker.Fill();
  ParameterInformation information(2);
  for (int i = 0; i < 15; ++i) MarginalizeOldest(&window, Threshold(0.1));
  information.Update(window, Threshold(0.1));
  const VectorXd scale = VectorXd::Constant(layout_.num_estimated(), 1.2);
  information.Rescale(RescalePrior(scale, &window));
  // A kept message over factors of the window scales them, too: the two agree up to their share.
  EXPECT_LT(Relative(Dense(window), information.Update(window, Threshold(0.1))), 0.25);
  // A whole redo, forced by parameters that moved, is exact.
  window.eta()[0] += 1.0;
  EXPECT_LT(Relative(Dense(window), information.Update(window, Threshold(0.1))), 1e-8);
}

TEST_F(ParameterInformationTest, IsSymmetricAndPositive) {
  LinearWindowOptions options;
  options.keyframes = 15;
  Window window(&layout_);
  LinearWindowMaker(&window, options, 13).Fill();
  ParameterInformation information;
  const MatrixXd H = information.Update(window, Threshold(0.1));
  EXPECT_EQ(H, H.transpose());
  EXPECT_EQ(Eigen::LLT<MatrixXd>(H).info(), Eigen::Success);
}

}  // namespace
}  // namespace test
}  // namespace odmc
