// What a doubtful stream makes of a sigma is told to the one who reads it.
#include <gtest/gtest.h>

#include "odmc/analysis/calibration.h"

namespace odmc {
namespace {

class DoubtRemarksOf : public ::testing::Test {
 protected:
  /// A parameter whose sigma has the doubts in it already.
  void Add(const std::string& name, double sigma, bool observable = true) {
    ParameterEstimate p;
    p.full_name = name;
    p.sigma = sigma;
    p.estimated = true;
    p.observable = observable;
    set_.parameters.push_back(p);
    ++n_;
  }

  std::vector<Finding> Remarks(const std::vector<Eigen::VectorXd>& changes) const {
    return DoubtRemarks(doubts_, changes, set_);
  }

  const std::vector<StreamDoubt> doubts_ = {{"rotor_speeds", 0.0, 0.973, 1},
                                            {"velocity", 0.004, 1.0, -1}};
  ParameterSet set_;
  int n_ = 0;
};

TEST_F(DoubtRemarksOf, ALargePartOfASigma) {
  Add("thrust.k_f", 1.0);
  Add("drag.d_x", 1.0);
  Add("inertia.x", 1.0, false);
  // Rotor 2 is 0.64 of the variance of k_f and all that is not observable; each is 0.3 of d_x.
  const std::vector<Finding> found =
      Remarks({Eigen::Vector3d(0.8, -0.55, 0.9), Eigen::Vector3d(0.1, 0.55, 0.0)});
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].check, "stream_doubt");
  EXPECT_EQ(found[0].leaves, Trust::kGood);
  EXPECT_EQ(found[0].what,
            "the recording does not exclude an error (speed of rotor 2: 2.7 % too small), which is "
            "a large part of sigma of thrust.k_f, drag.d_x");
  EXPECT_EQ(found[1].what,
            "the recording does not exclude an error (velocity: 4 ms late), which is a large part "
            "of sigma of drag.d_x");
}

TEST_F(DoubtRemarksOf, NothingWhereTheFlightItselfIsMost) {
  Add("thrust.k_f", 1.0);
  EXPECT_TRUE(
      Remarks({Eigen::VectorXd::Constant(1, 0.5), Eigen::VectorXd::Constant(1, 0.49)}).empty());
  EXPECT_EQ(1u, Remarks({Eigen::VectorXd::Constant(1, 0.75), Eigen::VectorXd::Zero(1)}).size());
}

TEST_F(DoubtRemarksOf, NothingWhereAReplayFailed) {
  Add("thrust.k_f", 1.0);
  EXPECT_TRUE(Remarks({Eigen::VectorXd::Constant(1, 0.9)}).empty());
}

}  // namespace
}  // namespace odmc
