#include "odmc/analysis/timing_report.h"

#include "odmc/analysis/json.h"
#include "odmc/text/format.h"

namespace odmc {

using Json = nlohmann::ordered_json;

Json QuantilesJson(const TimingFigures& f) {
  return {{"median", JsonNumber(f.median)},
          {"p95", JsonNumber(f.p95)},
          {"p99", JsonNumber(f.p99)},
          {"max", JsonNumber(f.max)}};
}

TableRow TimingRow(const TableRow& start, const TimingFigures& f) {
  TableRow row = start;
  for (const auto& value : {f.median, f.p95, f.p99, f.max}) row.push_back(Fixed(value, 2));
  row.push_back(std::to_string(f.updates));
  return row;
}

}  // namespace odmc
