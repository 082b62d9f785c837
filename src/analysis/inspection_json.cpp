#include "odmc/analysis/inspection_json.h"

#include <cmath>
#include <nlohmann/json.hpp>

namespace odmc {
namespace {

using Json = nlohmann::ordered_json;

Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

}  // namespace

Json FindingsJson(const std::vector<Finding>& findings) {
  Json json = Json::array();
  for (const Finding& f : findings) {
    Json entry = {{"check", f.check}, {"leaves", Name(f.leaves)}, {"what", f.what}};
    if (!f.mend.empty()) entry["mend"] = f.mend;
    if (f.span_s) {
      entry["from_s"] = Number(f.span_s->first);
      entry["to_s"] = Number(f.span_s->second);
    }
    json.push_back(entry);
  }
  return json;
}

Json TimeOffsetsJson(const std::vector<TimeOffset>& offsets) {
  Json json = Json::object();
  for (const TimeOffset& offset : offsets) {
    const Lag& lag = offset.lag;
    Json entry = {{"value_s", nullptr}, {"sigma_s", nullptr}};
    if (lag.determined()) {
      entry["value_s"] = Number(lag.lag_s);
      entry["sigma_s"] = Number(lag.sigma_s());
      entry["scatter_s"] = Number(lag.scatter_s);
    }
    entry["against"] = offset.against;
    entry["compensated"] = offset.compensated_s != 0.0;
    entry["compensated_s"] = Number(offset.compensated_s);
    json[offset.stream] = entry;
  }
  return json;
}

}  // namespace odmc
