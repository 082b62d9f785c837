#pragma once

#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

namespace odmc::testing_support {

/// What `run` throws as std::invalid_argument; fails the test where it does not throw one.
template <typename Run>
std::string ErrorOf(Run run) {
  try {
    run();
  } catch (const std::invalid_argument& e) {
    return e.what();
  } catch (const std::exception& e) {
    ADD_FAILURE() << "another exception: " << e.what();
    return "";
  }
  ADD_FAILURE() << "no exception";
  return "";
}

inline bool Contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace odmc::testing_support

/// Expects that `statement` throws std::invalid_argument and says `part`.
#define ODMC_EXPECT_ERROR(statement, part)                                                      \
  do {                                                                                          \
    const std::string odmc_error_ = odmc::testing_support::ErrorOf([&] { (void)(statement); }); \
    EXPECT_TRUE(odmc::testing_support::Contains(odmc_error_, part))                             \
        << "says: " << odmc_error_ << "\nshould contain: " << (part);                           \
  } while (false)
