#include "odmc/window/chain_corrections.h"

#include <algorithm>
#include <cmath>

namespace odmc {
namespace {

constexpr double kFirstBend = 0.3;  // error [sigmas] of fronts evaluated a sigma away
constexpr double kBendMemory = 0.7;
constexpr double kLeastDistance = 0.01;  // to learn it from [sigmas]

}  // namespace

void ChainCorrections::Append(const Window& window, std::int64_t id) {
  if (!segments_.empty() && id < segments_.back().first + options_->segment_keyframes) return;
  ChainSegment& segment = segments_.Append();
  segment.first = id;
  segment.at = window.eta();
  segment.sensitivity = kFirstBend;
}

void ChainCorrections::DropOldest() {
  if (chain_->fronts.empty()) {
    segments_.clear();
  } else if (segments_.front().first + options_->segment_keyframes <= chain_->oldest()) {
    segments_.pop_front();
  }
}

void ChainCorrections::NoteSwept(std::int64_t next) {
  const std::int64_t passed = (next - segments_.front().first) / options_->segment_keyframes;
  if (passed <= 0) return;
  ChainSegment& segment = segments_[static_cast<size_t>(passed - 1)];
  if (segment.first + options_->segment_keyframes == next) segment.at = chain_->point;
}

double ChainCorrections::ExpectErrors(const Window& window) {
  double squares = 0.0;
  for (ChainSegment& segment : segments_) {
    segment.expected = segment.sensitivity * error_->Distance(window, segment.at);
    squares += segment.expected * segment.expected;
  }
  return std::sqrt(squares);
}

ChainSegment* ChainCorrections::Choose(std::int64_t since, bool in_turn) {
  ChainSegment* chosen = nullptr;
  for (ChainSegment& segment : segments_) {
    if (segment.turn > since) continue;
    const bool better = chosen == nullptr || (in_turn ? segment.turn < chosen->turn
                                                      : segment.expected > chosen->expected);
    if (better) chosen = &segment;
  }
  return chosen;
}

void ChainCorrections::Correct(const Window& window, ChainSegment* segment) {
  std::fill(found_.begin(), found_.end(), 0.0);
  std::int64_t oldest = std::max(segment->first, chain_->oldest());
  // Fronts that have weights which the chain in use does not have wait until it does.
  if (sweep_->reweighs) oldest = std::max(oldest, sweep_->next);
  const std::int64_t recent = chain_->checkpoints.front().id;
  const std::int64_t end = std::min(segment->first + options_->segment_keyframes, recent);
  segment->expected = 0.0;
  segment->turn = ++turn_;
  if (end <= oldest) {  // all are recent, or have just been swept
    if (segment->first >= recent) segment->at = window.eta();
    return;
  }
  for (std::int64_t id = oldest; id < end; ++id) {
    if (sweep_->active && id == sweep_->next && id > oldest) GiveFoundTo(&sweep_->root);
    ++corrected;
    chain_->front(id).Correct(window, &chain_->front(id + 1), &chain_->scratch, found_.data());
  }
  const double change = GiveFoundToRoots(window, end);
  const double distance = error_->Distance(window, segment->at);
  if (distance > kLeastDistance) {
    segment->sensitivity = std::max(change / distance, kBendMemory * segment->sensitivity);
  }
  segment->at = window.eta();
}

void ChainCorrections::CorrectBeforeSweep(const Window& window, std::int64_t end) {
  std::fill(found_.begin(), found_.end(), 0.0);
  for (std::int64_t id = sweep_->next; id < end; ++id) {
    ++corrected;
    chain_->front(id).Correct(window, &chain_->front(id + 1), &chain_->scratch, found_.data());
  }
  GiveFoundToRoots(window, end);
}

void ChainCorrections::PassOnFromOldest(const Window& window) {
  std::fill(found_.begin(), found_.end(), 0.0);
  chain_->fronts.front().PassOn(&chain_->fronts[1], &chain_->scratch, found_.data());
  GiveFoundToRoots(window, chain_->fronts[1].id);
}

/// A root takes what was found at fronts before its next one. What went with the message to that
/// one it will absorb there.
void ChainCorrections::GiveFoundTo(RootTriangle* root) {
  given_ = found_;
  for (size_t j = 0; j < given_.size(); ++j) given_[j] -= chain_->scratch.taken[j];
  root->AddGradient(given_);
}

/// All roots take what was found at fronts before `end`; those of a later bias only what is about
/// the parameters. @returns how far the optimum moves [sigmas]
double ChainCorrections::GiveFoundToRoots(const Window& window, std::int64_t end) {
  const std::int64_t bias = window.keyframe(end).bias;
  const auto give = [&](RootTriangle* root, std::int64_t before) {
    const bool same = window.keyframe(before).bias == bias;
    if (same && before == end) {
      GiveFoundTo(root);
      return 0.0;
    }
    given_ = found_;
    if (!same) std::fill_n(given_.begin(), BorderColumns::kParameters, 0.0);
    return root->AddGradient(given_);
  };
  if (sweep_->active && end <= sweep_->next) give(&sweep_->root, sweep_->next);
  for (Chain::Checkpoint& checkpoint : chain_->checkpoints) give(&checkpoint.root, checkpoint.id);
  const std::int64_t newest = chain_->newest();
  if (window.keyframe(newest).bias != bias) {
    // It waits where its bias leaves.
    std::int64_t id = end;
    while (id < newest && !chain_->front(id).bias_leaves) ++id;
    for (size_t j = 0; j < 6; ++j) chain_->front(id).arrived[j] += found_[j];
    chain_->front(id).waits = true;
  }
  return give(&chain_->root, newest);
}

}  // namespace odmc
