#include "odmc/analysis/inspection_json.h"

#include "odmc/analysis/json.h"

namespace odmc {

using Json = nlohmann::ordered_json;

Json FindingsJson(const std::vector<Finding>& findings) {
  Json json = Json::array();
  for (const Finding& f : findings) {
    Json entry = {{"check", f.check}, {"leaves", Name(f.leaves)}, {"what", f.what}};
    if (!f.mend.empty()) entry["mend"] = f.mend;
    if (f.span_s) {
      entry["from_s"] = JsonNumber(f.span_s->first);
      entry["to_s"] = JsonNumber(f.span_s->second);
    }
    json.push_back(entry);
  }
  return json;
}

Json TimeOffsetsJson(const std::vector<TimeOffset>& offsets) {
  Json json = Json::object();
  for (const TimeOffset& offset : offsets) {
    const StreamLag& lag = offset.lag;
    Json entry = {{"value_s", nullptr}, {"sigma_s", nullptr}};
    if (lag.determined()) {
      entry["value_s"] = JsonNumber(lag.lag_s);
      entry["sigma_s"] = JsonNumber(lag.sigma_s());
      entry["scatter_s"] = JsonNumber(lag.scatter_s);
    }
    entry["against"] = offset.against;
    entry["compensated"] = offset.compensated_s != 0.0;
    entry["compensated_s"] = JsonNumber(offset.compensated_s);
    json[offset.stream] = entry;
  }
  return json;
}

}  // namespace odmc
