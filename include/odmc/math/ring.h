#pragma once

#include <cstddef>
#include <iterator>
#include <utility>
#include <vector>

namespace odmc {

/// Queue on a circular buffer, for streams that run all flight long: what leaves at the front stays
/// as a spare element, heap storage and all, and Append() hands it out again. Once it has grown to
/// its largest size it never allocates. References hold until it grows.
template <typename T>
class Ring {
 public:
  /// Walks from the front to the back.
  template <typename Owner, typename Value>
  class Iterator {
   public:
    using iterator_category = std::random_access_iterator_tag;
    using value_type = T;
    using difference_type = std::ptrdiff_t;
    using pointer = Value*;
    using reference = Value&;

    Iterator(Owner* ring, std::ptrdiff_t at) : ring_(ring), at_(at) {}
    reference operator*() const { return (*ring_)[static_cast<std::size_t>(at_)]; }
    pointer operator->() const { return &**this; }
    reference operator[](difference_type n) const { return *(*this + n); }
    Iterator& operator+=(difference_type n) { return at_ += n, *this; }
    Iterator& operator-=(difference_type n) { return at_ -= n, *this; }
    Iterator& operator++() { return *this += 1; }
    Iterator& operator--() { return *this -= 1; }
    Iterator operator+(difference_type n) const { return {ring_, at_ + n}; }
    Iterator operator-(difference_type n) const { return {ring_, at_ - n}; }
    difference_type operator-(const Iterator& other) const { return at_ - other.at_; }
    bool operator==(const Iterator& other) const { return at_ == other.at_; }
    bool operator!=(const Iterator& other) const { return at_ != other.at_; }
    bool operator<(const Iterator& other) const { return at_ < other.at_; }

   private:
    Owner* ring_;
    std::ptrdiff_t at_;
  };
  using iterator = Iterator<Ring, T>;
  using const_iterator = Iterator<const Ring, const T>;

  /// Room for so many elements, so that it does not grow before.
  void Reserve(std::size_t size) {
    if (size > slots_.size()) GrowTo(size);
  }

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }

  T& operator[](std::size_t i) { return slots_[Index(i)]; }
  const T& operator[](std::size_t i) const { return slots_[Index(i)]; }
  T& front() { return (*this)[0]; }
  const T& front() const { return (*this)[0]; }
  T& back() { return (*this)[size_ - 1]; }
  const T& back() const { return (*this)[size_ - 1]; }

  iterator begin() { return {this, 0}; }
  iterator end() { return {this, static_cast<std::ptrdiff_t>(size_)}; }
  const_iterator begin() const { return {this, 0}; }
  const_iterator end() const { return {this, static_cast<std::ptrdiff_t>(size_)}; }

  /// A new element at the back, as one that left has left it.
  T& Append() {
    if (size_ == slots_.size()) GrowTo(slots_.empty() ? 8 : 2 * slots_.size());
    ++size_;
    return back();
  }
  void push_back(T value) { Append() = std::move(value); }

  /// @pre not empty
  void pop_front() {
    first_ = first_ + 1 == slots_.size() ? 0 : first_ + 1;
    --size_;
  }
  void pop_back() { --size_; }
  void clear() { size_ = 0; }

 private:
  std::size_t Index(std::size_t i) const {
    const std::size_t at = first_ + i;
    return at < slots_.size() ? at : at - slots_.size();
  }

  void GrowTo(std::size_t size) {
    std::vector<T> larger(size);
    for (std::size_t i = 0; i < size_; ++i) larger[i] = std::move((*this)[i]);
    slots_ = std::move(larger);
    first_ = 0;
  }

  std::vector<T> slots_;
  std::size_t first_ = 0, size_ = 0;
};

}  // namespace odmc
