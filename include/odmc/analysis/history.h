#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdio>
#include <iterator>
#include <memory>
#include <vector>

#include "odmc/model/dynamic_model.h"

namespace odmc {

/// One line of the history: the estimate after one update.
struct HistoryRow {
  double t_s = 0.0;
  ModelValues values;
  Eigen::VectorXd sigma;
};

/// Lines of a history, all of one length. A few megabytes are held; what is older waits in an
/// unnamed file of the system's folder for temporary files (and is held, too, where there is no
/// room for one). Rows are read back bit by bit as they were written. Thread-compatible.
class EstimateHistory {
 public:
  void push_back(const HistoryRow& row);

  size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  HistoryRow operator[](size_t index) const;
  HistoryRow front() const { return (*this)[0]; }
  HistoryRow back() const { return (*this)[size_ - 1]; }

  /// Goes forward and reads a block at a time.
  class Iterator {
   public:
    using iterator_category = std::input_iterator_tag;
    using value_type = HistoryRow;
    using difference_type = std::ptrdiff_t;
    using pointer = const HistoryRow*;
    using reference = HistoryRow;

    Iterator(const EstimateHistory* history, size_t index) : history_(history), index_(index) {}
    HistoryRow operator*() const;
    Iterator& operator++() {
      ++index_;
      return *this;
    }
    bool operator!=(const Iterator& other) const { return index_ != other.index_; }

   private:
    const EstimateHistory* history_;
    size_t index_;
    mutable size_t block_ = static_cast<size_t>(-1);  // in numbers_
    mutable std::vector<double> numbers_;
  };
  Iterator begin() const { return {this, 0}; }
  Iterator end() const { return {this, size_}; }

 private:
  /// Rows one after the other: in `numbers`, or in the file from `offset` on.
  struct Block {
    std::vector<double> numbers;
    long offset = -1;
  };

  size_t RowsPerBlock() const;
  void Spill(Block* block);
  void Read(size_t block, std::vector<double>* numbers) const;
  HistoryRow RowOf(const double* numbers) const;

  Eigen::Index parameters_ = 0;
  size_t size_ = 0;
  std::vector<Block> blocks_;
  std::shared_ptr<std::FILE> file_;  // what is in it never changes: copies share it
};

}  // namespace odmc
