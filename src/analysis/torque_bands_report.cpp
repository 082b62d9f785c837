#include "odmc/analysis/torque_bands_report.h"

#include "odmc/analysis/json.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json QuantityJson(const BandedQuantity& q, const std::string& unit) {
  Json json = {{"unit", unit}};
  json["value"] = JsonNumber(q.value);
  json["sigma"] = q.value ? JsonNumber(q.sigma) : Json(nullptr);
  if (q.value) {
    json["chi_squared"] = JsonNumber(q.chi_squared);
    json["degrees_of_freedom"] = q.freedom;
    json["log_slope"] = JsonNumber(q.slope);
    json["log_slope_sigma"] = JsonNumber(q.slope_sigma);
  } else {
    json["why"] = q.why;
  }
  json["block_scatter"] = JsonNumber(q.block_scatter);
  json["block_freedom"] = JsonNumber(q.block_freedom);
  json["bands"] = Json::array();
  for (const BandEstimate& band : q.bands) {
    json["bands"].push_back({{"low_Hz", JsonNumber(band.low_Hz)},
                             {"high_Hz", JsonNumber(band.high_Hz)},
                             {"value", JsonNumber(band.value)},
                             {"sigma", JsonNumber(band.sigma)},
                             {"noise_sigma", JsonNumber(band.noise_sigma)},
                             {"coherence", JsonNumber(band.coherence)},
                             {"used", band.used}});
  }
  return json;
}

std::string Used(const BandedQuantity& q) {
  double low = 0.0, high = 0.0;
  for (const BandEstimate& band : q.bands) {
    if (!band.used) continue;
    if (low == 0.0) low = band.low_Hz;
    high = band.high_Hz;
  }
  return Format("%.1f to %.1f Hz, chi^2 %.1f of %d", low, high, q.chi_squared, q.freedom);
}

std::string Row(const char* name, const BandedQuantity& q, double scale, const char* unit) {
  if (!q.value) return Format("%-12s -  ", name) + q.why + "\n";
  return Format("%-12s %.4g +- %.2g %s (", name, scale * *q.value, scale * q.sigma, unit) +
         Used(q) + ")";
}

}  // namespace

Json TorqueBandsJson(const TorqueBands& bands, const Eigen::Vector3d& nominal) {
  if (!bands.why.empty()) return {{"why", bands.why}};
  Json json = {{"flight_s", JsonNumber(bands.flight_s)},
               {"phase_delay_s", JsonNumber(bands.delay_s)},
               {"phase_delay_sigma_s", JsonNumber(bands.delay_sigma_s)}};
  for (int axis = 0; axis < 2; ++axis) {
    const BandedQuantity& q = bands.inertia[static_cast<size_t>(axis)];
    Json entry = QuantityJson(q, "kg m^2");
    entry["over_nominal"] = q.value ? JsonNumber(*q.value / nominal[axis]) : Json(nullptr);
    json[axis == 0 ? "x" : "y"] = entry;
  }
  json["k_m_over_inertia_z"] = QuantityJson(bands.k_m_over_I, "1/rad^2");
  json["rotor_inertia_over_inertia_z"] = QuantityJson(bands.J_r_over_I, "1");
  if (bands.k_m) {
    const ReactionCheck& c = *bands.k_m;
    json["k_m"] = {{"unit", "N m s^2"},
                   {"in_use", JsonNumber(c.in_use)},
                   {"fits", JsonNumber(c.fits)},
                   {"sigma", JsonNumber(c.sigma)},
                   {"inertia_z_kg_m2", JsonNumber(c.inertia_z)},
                   {"inertia_z_sigma_kg_m2", JsonNumber(c.inertia_z_sigma)},
                   {"p", JsonNumber(c.p)},
                   {"contradicted", c.contradicted}};
  }
  return json;
}

std::string TorqueBandsTable(const TorqueBands& bands, const Eigen::Vector3d& nominal) {
  if (!bands.why.empty()) return "inertia by band: " + bands.why + "\n";
  std::string text =
      Format("inertia by band; phases as of a delay of %.1f ms\n", 1e3 * bands.delay_s);
  for (int axis = 0; axis < 2; ++axis) {
    const BandedQuantity& q = bands.inertia[static_cast<size_t>(axis)];
    text += Row(axis == 0 ? "  I_x" : "  I_y", q, 1.0, "kg m^2");
    if (q.value) text += Format(", %.2f of the vehicle file's\n", *q.value / nominal[axis]);
  }
  text += Row("  k_m / I_z", bands.k_m_over_I, 1.0, "1/rad^2");
  if (bands.k_m) {
    const ReactionCheck& c = *bands.k_m;
    text += Format(
        ":\n%-12s %.4g +- %.2g N m s^2 with I_z %.3g +- %.2g kg m^2, %.2f of the one in use\n",
        "    k_m", c.fits, c.sigma, c.inertia_z, c.inertia_z_sigma, c.fits / c.in_use);
  } else if (bands.k_m_over_I.value) {
    text += "\n";
  }
  text += Row("  J_r / I_z", bands.J_r_over_I, 1.0, "");
  if (bands.J_r_over_I.value && bands.k_m) {
    text += Format(":\n%-12s %.3g kg m^2 with the same\n", "    J_r",
                   *bands.J_r_over_I.value * bands.k_m->inertia_z);
  } else if (bands.J_r_over_I.value) {
    text += "\n";
  }
  return text;
}

}  // namespace odmc
