#include "odmc/analysis/history.h"

#include <algorithm>
#include <stdexcept>

namespace odmc {
namespace {

constexpr size_t kBlockBytes = 1 << 20;

}  // namespace

size_t EstimateHistory::RowsPerBlock() const {
  const size_t row_bytes = (1 + 2 * static_cast<size_t>(parameters_)) * sizeof(double);
  return std::max<size_t>(1, kBlockBytes / row_bytes);
}

void EstimateHistory::push_back(const HistoryRow& row) {
  if (empty()) parameters_ = row.values.size();
  if (row.values.size() != parameters_ || row.sigma.size() != parameters_) {
    throw std::invalid_argument("rows of a history must be of one length");
  }
  if (size_ % RowsPerBlock() == 0) {
    if (!blocks_.empty()) Spill(&blocks_.back());
    blocks_.emplace_back();
  }
  std::vector<double>& numbers = blocks_.back().numbers;
  numbers.push_back(row.t_s);
  numbers.insert(numbers.end(), row.values.data(), row.values.data() + parameters_);
  numbers.insert(numbers.end(), row.sigma.data(), row.sigma.data() + parameters_);
  ++size_;
}

void EstimateHistory::Spill(Block* block) {
  if (file_ == nullptr) {
    std::FILE* const file = std::tmpfile();
    if (file == nullptr) return;
    file_.reset(file, std::fclose);
  }
  const size_t count = block->numbers.size();
  if (std::fseek(file_.get(), 0, SEEK_END) != 0) return;
  const long offset = std::ftell(file_.get());
  const bool written =
      offset >= 0 &&
      std::fwrite(block->numbers.data(), sizeof(double), count, file_.get()) == count &&
      std::fflush(file_.get()) == 0;
  if (!written) return;  // it stays in memory
  block->offset = offset;
  block->numbers = {};
}

void EstimateHistory::Read(size_t block, std::vector<double>* numbers) const {
  const Block& at = blocks_[block];
  if (at.offset < 0) {
    *numbers = at.numbers;
    return;
  }
  numbers->resize(RowsPerBlock() * (1 + 2 * static_cast<size_t>(parameters_)));
  const bool read =
      std::fseek(file_.get(), at.offset, SEEK_SET) == 0 &&
      std::fread(numbers->data(), sizeof(double), numbers->size(), file_.get()) == numbers->size();
  if (!read) throw std::runtime_error("the history's temporary file cannot be read");
}

HistoryRow EstimateHistory::RowOf(const double* numbers) const {
  HistoryRow row;
  row.t_s = numbers[0];
  row.values = Eigen::Map<const Eigen::VectorXd>(numbers + 1, parameters_);
  row.sigma = Eigen::Map<const Eigen::VectorXd>(numbers + 1 + parameters_, parameters_);
  return row;
}

HistoryRow EstimateHistory::Iterator::operator*() const {
  const size_t rows = history_->RowsPerBlock();
  if (index_ / rows != block_) {
    block_ = index_ / rows;
    history_->Read(block_, &numbers_);
  }
  const size_t width = 1 + 2 * static_cast<size_t>(history_->parameters_);
  return history_->RowOf(numbers_.data() + index_ % rows * width);
}

HistoryRow EstimateHistory::operator[](size_t index) const { return *Iterator(this, index); }

}  // namespace odmc
