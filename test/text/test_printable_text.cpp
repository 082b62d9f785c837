#include <gtest/gtest.h>

#include "odmc/text/printable_text.h"

namespace odmc {
namespace {

TEST(PrintableText, LeavesTextAsItIs) {
  for (const std::string text : {"", "flight 1.csv", "k_f = 1.5e-06 N s^2", "Grüße, 飛行, 🚁"}) {
    EXPECT_EQ(Printable(text), text);
    EXPECT_EQ(Printable(Printable(text)), text);
  }
}

TEST(PrintableText, ShowsWhatATerminalWouldObey) {
  EXPECT_EQ(Printable("\x1b[31mred\x07"), "\\x1b[31mred\\x07");
  EXPECT_EQ(Printable("a\r\nb\tc\x7f"), "a\\x0d\\x0ab\\x09c\\x7f");
  EXPECT_EQ(Printable("\xc2\x9b"
                      "2J"),
            "\\xc2\\x9b2J");  // one of the C1 controls
  EXPECT_EQ(Printable("a\xe2\x80\xae"
                      "b"),
            "a\\xe2\\x80\\xaeb");  // right to left from here
  EXPECT_EQ(Printable(std::string("a\0b", 3)), "a\\x00b");
}

TEST(PrintableText, ShowsBytesThatAreNoUtf8) {
  EXPECT_EQ(Printable("\xff\xc3"), "\\xff\\xc3");
  EXPECT_EQ(Printable("\xc0\xaf"), "\\xc0\\xaf");                    // a slash, too long
  EXPECT_EQ(Printable("\xed\xa0\x80"), "\\xed\\xa0\\x80");           // half a pair of UTF-16
  EXPECT_EQ(Printable("\xf5\x80\x80\x80"), "\\xf5\\x80\\x80\\x80");  // beyond Unicode
}

TEST(PrintableText, IsCutWhereItIsLong) {
  EXPECT_EQ(Printable(std::string(100, 'a'), 10), "aaaaaaaaaa...");
  EXPECT_EQ(Printable("aaaaaaaaaa", 10), "aaaaaaaaaa");
}

}  // namespace
}  // namespace odmc
