#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "odmc/attribution/instruments.h"
#include "odmc/attribution/residual.h"

namespace odmc {

/// A flight that evidence is taken from; both outlive that.
struct FlightWithInstruments {
  const ResidualModel* residual;
  const Instruments* instruments;
};

/// What a force or torque might follow that nobody has a name for. A channel of the wrench: the
/// vehicle's state, place and time, and all products of two of them. A force fixed in the world:
/// the place, and nearness to places that cover where was flown. Where such functions explain as
/// much as a catalogue effect does, the effect is not taken for the cause (double selection;
/// Belloni, Chernozhukov and Hansen, Review of Economic Studies 2014).
struct FlexibleFeatures {
  std::vector<std::string> names;
  /// By flight: samples × features, as its instruments see them; of unit size over all flights.
  std::vector<Eigen::MatrixXd> foreseen;

  std::vector<std::string> world_names;
  /// By flight, of each channel of the force: samples × features.
  std::vector<std::array<Eigen::MatrixXd, 3>> world_foreseen;

  explicit FlexibleFeatures(const std::vector<FlightWithInstruments>& flights);

 private:
  void AddAlongBody(const std::vector<Eigen::MatrixXd>& signals,
                    const std::vector<Eigen::MatrixXd>& likely_signals,
                    const std::vector<FlightWithInstruments>& flights);
  void AddAlongWorld(const std::vector<Eigen::MatrixXd>& signals,
                     const std::vector<Eigen::MatrixXd>& likely_signals,
                     const std::vector<Eigen::MatrixXd>& near,
                     const std::vector<Eigen::MatrixXd>& likely_near,
                     const std::vector<std::string>& names_of_places,
                     const std::vector<FlightWithInstruments>& flights);
};

}  // namespace odmc
