#include "odmc/attribution/stream_effects.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "odmc/attribution/candidates.h"
#include "odmc/inspection/lag_regression.h"
#include "odmc/text/format.h"

namespace odmc {
namespace {

constexpr double kUsualOffset_s =
    0.02;  // standard deviation where stamps are wrong (docs/streams.md)

/// The effect that an offset of a stream is.
struct StreamEffect {
  const char* stream;
  const char* effect;
  const char* parameter;
};
constexpr StreamEffect kStreamEffects[] = {{"rotor_speeds", "rotor_delay", "rotor_delay.delay"}};

constexpr double kSigmasOfNone = 3.0;  // an offset within so many of its sigmas is none

std::string Milliseconds(double seconds) { return Format("%.1f ms", 1e3 * seconds); }

/// The channel of which slow rotor speeds leave out most.
const ChannelStructure* MostSampled(const ClosedLoop& loop) {
  const auto most = std::max_element(
      loop.structure.begin(), loop.structure.end(), [](const auto& one, const auto& other) {
        return one.whiteness.sampling_share < other.whiteness.sampling_share;
      });
  return most == loop.structure.end() ? nullptr : &*most;
}

/// What happens between samples far apart is in the residual, and is no lack of the model.
void WarnOfSparseStreams(const StreamInspection& inspection, const AttributionOptions& options,
                         ClosedLoop* loop) {
  const ChannelStructure* most = MostSampled(*loop);
  for (const StreamDoubt& doubt : inspection.doubts) {
    if (doubt.sparse_s < kSparse_s) continue;
    std::string does;
    if (loop->verdict == Verdict::kEffect) {
      does = "may pass for an effect";
    } else if (loop->verdict == Verdict::kUnexplained) {
      does = "may be what stays unexplained";
    } else if (doubt.stream == "rotor_speeds" && most != nullptr &&
               most->whiteness.sampling_share > options.least_structured) {
      does = "may be " + Rounded(100.0 * most->whiteness.sampling_share) +
             " % of the residual's variance (" + most->name + "), and hide an effect";
    }
    if (does.empty()) continue;
    loop->warnings.push_back("of " + doubt.stream + " there is one sample in " +
                             Rounded(1e3 * doubt.sparse_s) + " ms: what happens between them " +
                             does);
  }
}

bool HasFinding(const StreamInspection& inspection, const std::string& check) {
  return std::any_of(inspection.findings.begin(), inspection.findings.end(),
                     [&](const Finding& finding) { return finding.check == check; });
}

/// True if an offset as a whole is none, or no more than any recording has.
bool IsNoOffset(const RankedEffect& whole, const Vehicle& vehicle) {
  const ParameterEstimate& offset = whole.parameters.front();
  return std::abs(offset.value) <= kSigmasOfNone * offset.sigma || IsOrdinary(vehicle, whole);
}

/// What the loop found of an offset that was taken off, with a finding, where that takes the stamps
/// back to where they were, as a whole; else nothing.
std::optional<ParameterEstimate> TakenBackBy(const TimeOffset& offset,
                                             const StreamInspection& inspection,
                                             const Vehicle& vehicle, const ClosedLoop& loop) {
  if (offset.compensated_s == 0.0 || !HasFinding(inspection, offset.stream + "_offset")) {
    return std::nullopt;
  }
  for (const StreamEffect& kind : kStreamEffects) {
    if (offset.stream != kind.stream) continue;
    for (const AddedEffect& added : loop.effects) {
      if (added.effect.name != kind.effect) continue;
      RankedEffect whole;
      whole.name = kind.effect;
      whole.parameters = {*added.effect.Find(kind.parameter)};
      whole.parameters.front().value += offset.compensated_s;
      if (IsNoOffset(whole, vehicle)) return whole.parameters.front();
      return std::nullopt;
    }
  }
  return std::nullopt;
}

/// Takes out what inspection said of a stream's stamps.
void Forget(const std::string& stream, StreamInspection* inspection) {
  auto& findings = inspection->findings;
  findings.erase(
      std::remove_if(findings.begin(), findings.end(),
                     [&](const Finding& finding) { return finding.check == stream + "_offset"; }),
      findings.end());
  auto& doubts = inspection->doubts;
  doubts.erase(std::remove_if(doubts.begin(), doubts.end(),
                              [&](const StreamDoubt& doubt) {
                                return doubt.stream == stream && doubt.late_s != 0.0;
                              }),
               doubts.end());
}

/// Log likelihood ratio of an offset of the usual size to none [nats].
double GainOf(double lag_s, double sigma_s) {
  const double variance = sigma_s * sigma_s;
  const double with_offset = variance + kUsualOffset_s * kUsualOffset_s;
  return 0.5 *
         (lag_s * lag_s * (1.0 / variance - 1.0 / with_offset) + std::log(variance / with_offset));
}

/// @param tried effects that might have been named, by whose number p is corrected
RankedEffect TakenOff(const TimeOffset& offset, const StreamEffect& kind, double tried,
                      double log_prior_odds) {
  const double sigma_s = offset.lag.sigma_s();
  RankedEffect effect;
  effect.name = kind.effect;
  effect.score = GainOf(offset.lag.lag_s, sigma_s);
  const double alone = std::erfc(std::abs(offset.lag.lag_s) / sigma_s * std::sqrt(0.5));
  effect.p_value = std::min(1.0, tried * alone);
  effect.probability = 1.0 / (1.0 + std::exp(-effect.score - log_prior_odds));
  effect.parameters = {{kind.parameter, "s", offset.compensated_s, sigma_s, true, true}};
  return effect;
}

/// True if the lag explains more than the stamps as they are, beyond chance between blocks of time.
/// (A position controller that answers noise of the velocity makes rotors lead it by up to 15 ms,
/// five of the lag's sigmas, and the stamps as they are explain the flight as well.)
bool ExplainsMore(const TimeOffset& offset) { return offset.lag.over_none >= kLeastContrast; }

void Name(const RankedEffect& taken_off, bool explains_more, const CloseLoopOptions& options,
          const Vehicle& vehicle, ClosedLoop* loop) {
  std::vector<AddedEffect>& effects = loop->effects;
  const auto rest = std::find_if(effects.begin(), effects.end(), [&](const AddedEffect& added) {
    return added.effect.name == taken_off.name;
  });
  if (rest == effects.end()) {
    const bool is_ruled_out =
        std::count(options.ruled_out.begin(), options.ruled_out.end(), taken_off.name) > 0;
    const bool has_room = static_cast<int>(effects.size()) < options.attribution.most_effects;
    const bool may_be_chance = taken_off.p_value >= options.attribution.false_alarm_rate;
    if (is_ruled_out || !has_room || may_be_chance || !explains_more) return;
    if (IsOrdinary(vehicle, taken_off)) {
      loop->warnings.push_back(OrdinaryText(vehicle, taken_off));
      return;
    }
    if (loop->verdict == Verdict::kNone) loop->verdict = Verdict::kEffect;
    const auto weaker = std::find_if(effects.begin(), effects.end(), [&](const AddedEffect& added) {
      return added.effect.score < taken_off.score;
    });
    AddedEffect named;
    named.effect = taken_off;
    named.taken_off = true;
    effects.insert(weaker, named);
    return;
  }
  rest->taken_off = true;
  rest->effect.score += taken_off.score;
  rest->effect.p_value = std::min(rest->effect.p_value, taken_off.p_value);
  for (ParameterEstimate& p : rest->effect.parameters) {
    if (p.full_name != taken_off.parameters.front().full_name) continue;
    p.value += taken_off.parameters.front().value;  // sigma is that of the rest: it was seen last
  }
}

}  // namespace

void AddInspection(const StreamInspection& inspection, const CloseLoopOptions& options,
                   const Vehicle& vehicle, ClosedLoop* loop) {
  AddInspection<ClosedLoop>(inspection, loop);
  WarnOfSparseStreams(inspection, options.attribution, loop);
  const auto tried = static_cast<double>(std::max<size_t>(1, loop->ranking.size()));
  for (const TimeOffset& offset : inspection.offsets) {
    for (const StreamEffect& kind : kStreamEffects) {
      if (offset.stream != kind.stream || offset.compensated_s == 0.0) continue;
      if (!HasFinding(inspection, offset.stream + "_offset")) continue;
      Name(TakenOff(offset, kind, tried, options.attribution.log_prior_odds), ExplainsMore(offset),
           options, vehicle, loop);
    }
  }
}

bool TakesBack(const ClosedLoop& loop, const StreamInspection& inspection, const Vehicle& vehicle) {
  return std::any_of(inspection.offsets.begin(), inspection.offsets.end(),
                     [&](const TimeOffset& offset) {
                       return TakenBackBy(offset, inspection, vehicle, loop).has_value();
                     });
}

std::string PutBack(const ClosedLoop& loop, const Vehicle& vehicle, StreamInspection* inspection,
                    FlightLog* log) {
  std::string said;
  for (TimeOffset& offset : inspection->offsets) {
    const std::optional<ParameterEstimate> whole = TakenBackBy(offset, *inspection, vehicle, loop);
    if (!whole) continue;
    said += (said.empty() ? "" : "; ") + offset.stream + ": inspection took " +
            Milliseconds(offset.compensated_s) + " (sigma " + Milliseconds(offset.lag.sigma_s()) +
            ") off the stamps by comparison with " + offset.against +
            ", but the model as a whole finds " + Milliseconds(whole->value) + " (sigma " +
            Milliseconds(whole->sigma) + "): the stamps are left as they are";
    ShiftStream(offset.stream, -offset.compensated_s, log);
    Forget(offset.stream, inspection);
    inspection->doubts.push_back({offset.stream, std::hypot(whole->value, whole->sigma)});
    offset.compensated_s = 0.0;
  }
  return said;
}

ClosedLoop CloseLoopInspected(const FlightLog& log, const StreamInspection& inspected,
                              const Vehicle& file_vehicle, const Vehicle& vehicle,
                              CloseLoopOptions options, const std::optional<ParameterSet>& start,
                              const std::function<void(double)>& progress) {
  StreamInspection inspection = inspected;
  options.doubts = inspection.doubts;
  ClosedLoop loop = CloseLoop(log, file_vehicle, vehicle, options, progress);
  if (TakesBack(loop, inspection, vehicle)) {
    FlightLog with_stamps_back = log;
    const std::string said = PutBack(loop, vehicle, &inspection, &with_stamps_back);
    options.doubts = inspection.doubts;
    loop = CloseLoop(with_stamps_back, file_vehicle, vehicle, options, {});
    loop.warnings.push_back(said);
  }
  AddInspection(inspection, options, vehicle, &loop);
  if (start) WarnOfOtherMass(*start, file_vehicle, &loop.warnings);
  return loop;
}

}  // namespace odmc
