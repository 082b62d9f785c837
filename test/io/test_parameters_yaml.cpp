#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <regex>

#include "odmc/io/parameters_yaml.h"
#include "odmc/text/number_text.h"
#include "support/error_text.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

ParameterSet Sample() {
  ParameterSet set;
  set.effects = {"thrust", "rotor_torque", "drag"};
  set.parameters = {{"thrust.k_f", "N s^2", 1.4999999999999999e-6, 1e-9 / 3.0, true, true},
                    {"rotor_torque.k_m", "N m s^2", 2e-8, 0.0, false, false},
                    {"drag.d_x", "N s/m", -0.1 - 0.2, 1e-20, true, false}};
  set.covariance = Eigen::MatrixXd::Zero(3, 3);
  set.covariance(0, 0) = 1e-18 / 9.0;
  set.covariance(0, 2) = set.covariance(2, 0) = -1.0 / 7e9;
  set.covariance(2, 2) = 1e5;
  set.provenance = {{"flight", "a \"quoted\" name: #1.csv"}, {"notes", "two\nlines \\ and tab\t"}};
  return set;
}

void ExpectSame(const ParameterSet& a, const ParameterSet& b) {
  EXPECT_EQ(a.effects, b.effects);
  EXPECT_EQ(a.provenance, b.provenance);
  ASSERT_EQ(a.parameters.size(), b.parameters.size());
  for (size_t i = 0; i < a.parameters.size(); ++i) {
    EXPECT_EQ(a.parameters[i].full_name, b.parameters[i].full_name);
    EXPECT_EQ(a.parameters[i].unit, b.parameters[i].unit);
    EXPECT_EQ(a.parameters[i].value, b.parameters[i].value);
    EXPECT_EQ(a.parameters[i].sigma, b.parameters[i].sigma);
    EXPECT_EQ(a.parameters[i].estimated, b.parameters[i].estimated);
    EXPECT_EQ(a.parameters[i].observable, b.parameters[i].observable);
  }
  ASSERT_EQ(a.covariance.rows(), b.covariance.rows());
  EXPECT_TRUE(a.covariance == b.covariance);
}

ParameterSet Parse(const std::string& text) { return ParseParameters(text, "p.yaml"); }

TEST(ParametersYaml, RoundTripKeepsEveryBit) {
  const testing_support::TemporaryFolder folder;
  SaveParameters(Sample(), folder.File("p.yaml"));
  ExpectSame(Sample(), LoadParameters(folder.File("p.yaml")));
}

TEST(ParametersYaml, EmptyCovarianceAndProvenanceStayEmpty) {
  ParameterSet set = Sample();
  set.covariance.resize(0, 0);
  set.provenance.clear();
  ExpectSame(set, Parse(FormatParameters(set)));
}

// The float pattern of YAML 1.1 as PyYAML has it: a point, and a sign in the exponent.
TEST(ParametersYaml, ScatterBetweenFlightsIsKept) {
  ParameterSet set = Sample();
  set.parameters[2].scatter = 0.1 / 3.0;
  const ParameterSet back = ParseParameters(FormatParameters(set), "fleet.yaml");
  EXPECT_EQ(back.parameters[2].scatter, set.parameters[2].scatter);
  EXPECT_EQ(back.parameters[0].scatter, 0.0);
  // The next flight may have a value as far away as flights scatter.
  Vehicle vehicle;
  ApplyParameters(back, &vehicle);
  EXPECT_DOUBLE_EQ(*vehicle.parameters.at("drag.d_x").sigma, std::hypot(1e-20, 0.1 / 3.0));
}

TEST(ParametersYaml, KnowsParametersOfEveryRotor) {
  ParameterSet set;
  set.effects = {"thrust", "rotor_asymmetry", "rotor_tilt"};
  set.parameters = {{"rotor_asymmetry.delta_4", "1", 0.1, 0.01, true, true},
                    {"rotor_tilt.alpha_6y", "rad", 0.01, 0.01, true, true}};
  ExpectSame(ParseParameters(FormatParameters(set), "extended.yaml"), set);
}

TEST(ParametersYaml, NumbersAreFloatsForYaml11) {
  const std::regex yaml11("[-+]?[0-9]+\\.[0-9]*([eE][-+][0-9]+)?");
  for (const double value : {0.0, -0.0, 1.0, -3.0, 1e-6, 5e-6, 1e6, 1e5, 1e20, 1e-300, 0.1, 1e22,
                             1.4999999999999999e-6, 123456.0, std::nextafter(1.0, 2.0)}) {
    const std::string text = FormatYamlNumber(value);
    EXPECT_TRUE(std::regex_match(text, yaml11)) << text;
    double back = 0.0;
    ASSERT_TRUE(ParseNumber(text, &back));
    EXPECT_EQ(back, value);
    EXPECT_EQ(std::signbit(back), std::signbit(value));
  }
  EXPECT_EQ(FormatYamlNumber(1e-6), "1.0e-06");
  EXPECT_EQ(FormatYamlNumber(1.5e-6), "1.5e-06");
}

TEST(ParametersYaml, NumbersInQuotesAreRead) {
  const ParameterSet set = Parse("effects: [thrust]\nparameters: {thrust.k_f: {value: '1e-6'}}\n");
  EXPECT_EQ(set.parameters[0].value, 1e-6);
}

TEST(ParametersYaml, HandMadeFileNeedsOnlyValues) {
  const ParameterSet set = Parse(
      "effects: [thrust, rotor_torque]\n"
      "parameters: {thrust.k_f: {value: 1.0e-06}, rotor_torque.k_m: {value: 1.0e-08}}\n");
  EXPECT_EQ(set.parameters[0].unit, "N s^2");
  EXPECT_TRUE(set.parameters[0].estimated);
  EXPECT_FALSE(set.parameters[1].estimated);  // frozen by default
  EXPECT_EQ(set.covariance.size(), 0);
}

TEST(ParametersYaml, CovarianceMayComeInAnotherOrder) {
  const ParameterSet set = Parse(
      "effects: [thrust, rotor_torque]\n"
      "parameters: {thrust.k_f: {value: 1.0e-06}, rotor_torque.k_m: {value: 1.0e-08}}\n"
      "covariance: {order: [rotor_torque.k_m, thrust.k_f], matrix: [[1.0, 0.5], [0.5, 2.0]]}\n");
  EXPECT_EQ(set.covariance(0, 0), 2.0);
  EXPECT_EQ(set.covariance(1, 1), 1.0);
}

TEST(ParametersYaml, NonFiniteNumbersAreNotSaved) {
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    ParameterSet set = Sample();
    set.parameters[2].sigma = bad;
    ODMC_EXPECT_ERROR(FormatParameters(set), "drag.d_x.sigma is not finite");
    set = Sample();
    set.covariance(0, 2) = bad;
    ODMC_EXPECT_ERROR(FormatParameters(set), "covariance of thrust.k_f, drag.d_x is not finite");
  }
}

TEST(ParametersYaml, BadFilesAreRefused) {
  const std::string head = "effects: [thrust]\n";
  ODMC_EXPECT_ERROR(Parse("parameters: {}\n"), "p.yaml: effects: is missing");
  ODMC_EXPECT_ERROR(Parse(head), "p.yaml: parameters: is missing");
  ODMC_EXPECT_ERROR(Parse("effects: [thrusts]\nparameters: {}\n"), "effects[0]: must be one of");
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {thrust.k_f: {sigma: 1.0}}\n"),
                    "parameters.thrust.k_f.value: is missing");
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {thrust.k_f: {value: .nan}}\n"), "finite");
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {thrust.k_f: {value: -1.0}}\n"), "positive");
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {thrust.kf: {value: 1.0}}\n"), "mean thrust.k_f?");
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {rotor_tilt.alpha_9x: {value: 0.0}}\n"),
                    "rotor_tilt.alpha_9x");  // no vehicle has a ninth rotor
  ODMC_EXPECT_ERROR(Parse(head + "parameters: {thrust.k_f: {value: 1.0, unit: g}}\n"),
                    "thrust.k_f.unit: is 'g'");
  const std::string one = head + "parameters: {thrust.k_f: {value: 1.0}}\n";
  ODMC_EXPECT_ERROR(Parse(one + "covariance: {order: [drag.d_x], matrix: [[1.0]]}\n"),
                    "covariance.order[0]: 'drag.d_x' is not among");
  ODMC_EXPECT_ERROR(Parse(one + "covariance: {order: [thrust.k_f], matrix: [[1.0, 2.0]]}\n"),
                    "covariance.matrix[0]: must have one number");
  ODMC_EXPECT_ERROR(Parse(one + "covariance: {order: [thrust.k_f], matrix: [[-1.0]]}\n"),
                    "negative variance");
}

// In other units every entry has another size: correlations tell.
TEST(ParametersYaml, CovariancesThatAreNoneAreRefused) {
  const auto with = [](const std::string& matrix) {
    return Parse(
        "effects: [thrust, drag]\n"
        "parameters: {thrust.k_f: {value: 1.0e-06}, drag.d_x: {value: -0.1}}\n"
        "covariance: {order: [thrust.k_f, drag.d_x], matrix: " +
        matrix + "}\n");
  };
  EXPECT_NO_THROW(with("[[1.0e-18, 0.9e-10], [0.9e-10, 1.0e-02]]"));
  EXPECT_NO_THROW(with("[[1.0e-18, 1.0e-10], [1.0000001e-10, 1.0e-02]]"));  // rounded
  EXPECT_NO_THROW(with("[[0.0, 0.0], [0.0, 1.0e-02]]"));
  ODMC_EXPECT_ERROR(with("[[1.0e-18, 0.9e-10], [0.5e-10, 1.0e-02]]"), "matrix: is not symmetric");
  ODMC_EXPECT_ERROR(with("[[1.0e-18, 1.1e-10], [1.1e-10, 1.0e-02]]"), "matrix: is not positive");
  ODMC_EXPECT_ERROR(with("[[0.0, 1.0e-10], [1.0e-10, 1.0e-02]]"), "variance of zero beside");
  ODMC_EXPECT_ERROR(with("[[1.0e-320, 1.0e+300], [1.0e+300, 1.0e-02]]"), "matrix: is not ");
}

TEST(ParametersYaml, UnwritableFileIsARuntimeError) {
  EXPECT_THROW(SaveParameters(Sample(), "/no/such/folder/p.yaml"), std::runtime_error);
}

}  // namespace
}  // namespace odmc
