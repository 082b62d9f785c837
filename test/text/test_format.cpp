#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <string>

#include "odmc/text/format.h"
#include "odmc/text/refusal.h"
#include "odmc/text/table.h"

namespace odmc {
namespace {

TEST(Format, PrintsTextsOfAnyLength) {
  const std::string name(500, 'x');
  EXPECT_EQ(Format("%s: %.2f m", name.c_str(), 1.234), name + ": 1.23 m");
  EXPECT_EQ(Format("nothing"), "nothing");
}

TEST(Rounded, KeepsSoManyDigits) {
  EXPECT_EQ(Rounded(0.0123456), "0.0123");
  EXPECT_EQ(Rounded(123456.0, 2), "1.2e+05");
  EXPECT_EQ(Fixed(2.0 / 3.0, 1), "0.7");
}

TEST(Rounded, ShowsADashForWhatCannotBeHad) {
  EXPECT_EQ(Rounded(std::nullopt), "-");
  EXPECT_EQ(Rounded(std::numeric_limits<double>::quiet_NaN()), "-");
  EXPECT_EQ(Fixed(std::numeric_limits<double>::infinity(), 2), "-");
}

TEST(Table, AlignsNamesLeftAndNumbersRight) {
  EXPECT_EQ(AlignColumns({{"name", "x"}, {"k", "12.5"}}, 1), "name     x\nk     12.5\n");
}

TEST(Refusal, NamesTheFile) {
  try {
    RefuseFile("a.csv", "is empty");
    FAIL();
  } catch (const std::invalid_argument& e) {
    EXPECT_STREQ(e.what(), "a.csv: is empty");
  }
  std::string error;
  EXPECT_FALSE(Invalid(&error, "must be positive"));
  EXPECT_EQ(error, "must be positive");
  EXPECT_FALSE(Invalid(nullptr, "unread"));
}

}  // namespace
}  // namespace odmc
