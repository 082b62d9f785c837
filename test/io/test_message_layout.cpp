#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>

#include "odmc/io/message_layout.h"
#include "support/error_text.h"
#include "support/message_bytes.h"

namespace odmc {
namespace {

using testing_support::kDependency;
using testing_support::MessageBytes;
using testing_support::With;
using testing_support::WithHeader;

std::vector<double> Numbers(const MessageLayout& layout, const std::string& path,
                            const MessageBytes& bytes) {
  return layout.Numbers(layout.Find(path), bytes.data(), bytes.size());
}

constexpr char kEveryType[] =
    "bool a_bool\nint8 a_int8\nbyte a_byte\nuint8 a_uint8\nchar a_char\nint16 a_int16\n"
    "uint16 a_uint16\nint32 a_int32\nuint32 a_uint32\nint64 a_int64\nuint64 a_uint64\n"
    "float32 a_float32\nfloat64 a_float64\nstring a_string\ntime a_time\nduration a_duration\n"
    "float64 last\n";

MessageBytes EveryType() {
  MessageBytes bytes;
  bytes.Add(std::uint8_t{1}).Add(std::int8_t{-128}).Add(std::int8_t{-1}).Add(std::uint8_t{255});
  bytes.Add(std::uint8_t{200}).Add(std::int16_t{-32768}).Add(std::uint16_t{65535});
  bytes.Add(std::int32_t{-2147483647}).Add(std::uint32_t{4294967295});
  bytes.Add(std::int64_t{-9007199254740992}).Add(std::uint64_t{9007199254740992});
  bytes.Add(0.1f).Add(-1e300).AddText("text # with = signs").AddStamp(1700000000123456789);
  bytes.AddStamp(0).Add(42.0);
  return bytes;
}

TEST(MessageLayout, ReadsEveryBuiltinType) {
  const MessageLayout layout("a/Every", kEveryType);
  const MessageBytes bytes = EveryType();
  const std::vector<std::pair<std::string, double>> expected = {
      {"a_bool", 1},
      {"a_int8", -128},
      {"a_byte", -1},
      {"a_uint8", 255},
      {"a_char", 200},
      {"a_int16", -32768},
      {"a_uint16", 65535},
      {"a_int32", -2147483647},
      {"a_uint32", 4294967295.0},
      {"a_int64", -9007199254740992.0},
      {"a_uint64", 9007199254740992.0},
      {"a_float32", 0.1f},
      {"a_float64", -1e300},
      {"a_time", 1e-9 * 1700000000123456789},
      {"a_duration", 0},
      {"last", 42}};
  for (const auto& [name, value] : expected) {
    EXPECT_EQ(Numbers(layout, name, bytes), std::vector<double>{value}) << name;
  }
  EXPECT_EQ(layout.Stamps(layout.Find("a_time"), bytes.data(), bytes.size()),
            std::vector<Stamp>{1700000000123456789});
  EXPECT_EQ(layout.Texts(layout.Find("a_string"), bytes.data(), bytes.size()),
            std::vector<std::string>{"text # with = signs"});
}

TEST(MessageLayout, ReadsNegativeDurations) {
  const MessageLayout layout("a/D", "duration d\n");
  MessageBytes bytes;
  bytes.Add(std::int32_t{-2}).Add(std::int32_t{500000000});
  EXPECT_EQ(layout.Stamps(layout.Find("d"), bytes.data(), bytes.size()),
            std::vector<Stamp>{-1500000000});
}

TEST(MessageLayout, PassesOverConstantsAndComments) {
  const MessageLayout layout("a/C",
                             "# float64 not_this\nuint8 ONE=1\nstring NAME=a # b = c\n\r\n"
                             "  float64\tx   # y = 3\nint32 TWO = 2 # two\nfloat64 y\n");
  MessageBytes bytes;
  bytes.Add(1.0).Add(2.0);
  EXPECT_EQ(Numbers(layout, "x", bytes), std::vector<double>{1.0});
  EXPECT_EQ(Numbers(layout, "y", bytes), std::vector<double>{2.0});
  EXPECT_FALSE(layout.Has("ONE"));
}

TEST(MessageLayout, FollowsPathsThroughArraysOfMessages) {
  const MessageLayout layout("mavros_msgs/ESCStatus", testing_support::EscStatusDefinition());
  const MessageBytes bytes = testing_support::EscStatus(5000000003, {100, -200, 300, 400});
  EXPECT_EQ(Numbers(layout, "esc_status[].rpm", bytes), (std::vector<double>{100, -200, 300, 400}));
  EXPECT_EQ(Numbers(layout, "esc_status.rpm", bytes), Numbers(layout, "esc_status[].rpm", bytes));
  EXPECT_EQ(Numbers(layout, "esc_status[1].rpm", bytes), std::vector<double>{-200});
  EXPECT_EQ(layout.Stamps(layout.Find("header.stamp"), bytes.data(), bytes.size()),
            std::vector<Stamp>{5000000003});
  EXPECT_EQ(layout.Stamps(layout.Find("esc_status[].header.stamp"), bytes.data(), bytes.size()),
            std::vector<Stamp>(4, 5000000004));
}

// Names without a package are those of the message they are in.
TEST(MessageLayout, ReadsArraysWithinArraysAndFixedOnes) {
  const std::string definition =
      With(With("Arm[2] arms\nuint8 last\n", "my_pkg/Arm", "string name\nMotor[] motors\n"),
           "my_pkg/Motor", "float32[3] axis\nint16 rpm\n");
  const MessageLayout layout("my_pkg/Robot", definition);
  MessageBytes bytes;
  std::int16_t rpm = 10;
  for (const std::uint32_t motors : {1u, 2u}) {
    bytes.AddText("arm").Add(motors);
    for (std::uint32_t i = 0; i < motors; ++i, ++rpm) bytes.Add(0.5f).Add(1.f).Add(0.f).Add(rpm);
  }
  bytes.Add(std::uint8_t{9});
  EXPECT_EQ(Numbers(layout, "arms[].motors[].rpm", bytes), (std::vector<double>{10, 11, 12}));
  EXPECT_EQ(Numbers(layout, "arms[1].motors[].rpm", bytes), (std::vector<double>{11, 12}));
  EXPECT_EQ(Numbers(layout, "arms[1].motors[0].axis[]", bytes), (std::vector<double>{0.5, 1, 0}));
  EXPECT_EQ(Numbers(layout, "last", bytes), std::vector<double>{9});
  ODMC_EXPECT_ERROR(layout.Find("arms[2].name"), "'arms' has 2 entries");
  ODMC_EXPECT_ERROR(Numbers(layout, "arms[0].motors[1].rpm", bytes),
                    "my_pkg/Robot: a message has 1 entries in arms[0].motors, not 2");
}

TEST(MessageLayout, NamesWhatAPathMisses) {
  const MessageLayout layout("mavros_msgs/ESCStatus", testing_support::EscStatusDefinition());
  ODMC_EXPECT_ERROR(layout.Find("esc_status[].speed"),
                    "mavros_msgs/ESCStatus: field 'esc_status[].speed': there is no 'speed' in "
                    "mavros_msgs/ESCStatusItem, which has header, rpm, voltage, current");
  ODMC_EXPECT_ERROR(layout.Find("esc_status"), "choose of header, rpm, voltage, current");
  ODMC_EXPECT_ERROR(layout.Find("header[].stamp"), "'header' is no array");
  ODMC_EXPECT_ERROR(layout.Find("header.stamp.secs"), "nothing lies within 'stamp'");
  ODMC_EXPECT_ERROR(layout.Find(""), "is empty");
  for (const std::string path :
       {".", "..", "[", "]", "[]", "esc_status[", "esc_status[x]", "esc_status[-1].rpm",
        "esc_status[99999999999].rpm", "a b", ".header", "header..stamp", "esc_status[].rpm."}) {
    EXPECT_FALSE(layout.Has(path) && path != "esc_status[].rpm.") << path;
  }
  const MessageBytes bytes = testing_support::EscStatus(1, {1});
  ODMC_EXPECT_ERROR(Numbers(layout, "header.frame_id", bytes), "is text, not a number");
  ODMC_EXPECT_ERROR(layout.Stamps(layout.Find("esc_status[].rpm"), bytes.data(), bytes.size()),
                    "is no time");
}

TEST(MessageLayout, RefusesMessagesCutAtAnyByte) {
  const MessageBytes every = EveryType();
  const MessageBytes esc = testing_support::EscStatus(1, {1, 2, 3, 4});
  const MessageLayout every_layout("a/Every", kEveryType);
  const MessageLayout esc_layout("mavros_msgs/ESCStatus", testing_support::EscStatusDefinition());
  const auto expect_refused = [](const MessageLayout& layout, const std::string& path,
                                 const MessageBytes& bytes) {
    const FieldPath field = layout.Find(path);
    for (size_t size = 0; size < bytes.size(); ++size) {
      // A copy of its own, so that a sanitizer sees any byte that is read beyond.
      const std::vector<std::uint8_t> cut(bytes.data(), bytes.data() + size);
      ODMC_EXPECT_ERROR(layout.Numbers(field, cut.data(), cut.size()),
                        layout.type() + ": a message ends at byte " + std::to_string(size));
    }
    std::vector<std::uint8_t> longer = bytes.bytes();
    longer.push_back(0);
    ODMC_EXPECT_ERROR(layout.Numbers(field, longer.data(), longer.size()),
                      "has 1 bytes after its last field");
  };
  expect_refused(every_layout, "a_bool", every);
  expect_refused(every_layout, "last", every);
  expect_refused(esc_layout, "esc_status[].rpm", esc);
  expect_refused(esc_layout, "header.seq", esc);
  const std::vector<std::uint8_t> cut(esc.data(), esc.data() + 50);
  ODMC_EXPECT_ERROR(esc_layout.Numbers(esc_layout.Find("esc_status[].rpm"), cut.data(), 50),
                    "but esc_status at byte 20 takes 112 more");
}

// A count of four thousand million entries is refused before anything is done for them.
TEST(MessageLayout, RefusesCountsThatDoNotFit) {
  const MessageLayout layout("a/L", "float64[] x\nstring[] names\n");
  MessageBytes bytes;
  bytes.Add(std::uint32_t{0xFFFFFFFF}).Add(1.0);
  ODMC_EXPECT_ERROR(Numbers(layout, "x", bytes), "a/L: a message ends at byte 12, but x at byte 4");
  MessageBytes names;
  names.Add(std::uint32_t{0}).Add(std::uint32_t{2}).AddText("a").Add(std::uint32_t{0xFFFFFFF0});
  ODMC_EXPECT_ERROR(Numbers(layout, "x", names), "but names[1] at byte");
}

// Entries without bytes cost nothing, whatever their number.
TEST(MessageLayout, PassesOverEmptyMessages) {
  const MessageLayout layout(
      "a/E", With("b/Empty[] many\nb/Empty[4000000000] more\nfloat64 x\n", "b/Empty", "\n"));
  MessageBytes bytes;
  bytes.Add(std::uint32_t{0xFFFFFFFF}).Add(7.0);
  EXPECT_EQ(Numbers(layout, "x", bytes), std::vector<double>{7.0});
  EXPECT_FALSE(layout.Has("many"));
  const MessageLayout none("a/N", With("b/None[] items\n", "b/None", "float64[0] x\n"));
  ODMC_EXPECT_ERROR(none.Find("items[].x[]"), "never has an entry");
}

TEST(MessageLayout, RefusesDefinitionsThatAreNone) {
  const auto parse = [](const std::string& text) { MessageLayout("a/B", text); };
  ODMC_EXPECT_ERROR(parse("float64\n"), "a/B: line 1 of its definition is no field: 'float64'");
  ODMC_EXPECT_ERROR(parse("float64 x\nfloat64[ y\n"), "line 2 of its definition is no field");
  ODMC_EXPECT_ERROR(parse("float64[-1] y\n"), "is no field");
  ODMC_EXPECT_ERROR(parse("float64[99999999999] y\n"), "is no field");
  ODMC_EXPECT_ERROR(parse("Thing x\n"), "uses a/Thing for x and does not say what it is");
  ODMC_EXPECT_ERROR(parse(kDependency + "\nfloat64 x\n"), "line 2 of its definition names no type");
  ODMC_EXPECT_ERROR(parse(With("c/D d\n", "c/D", "c/E e\n") + kDependency + "\nMSG: c/E\nc/D d\n"),
                    "has c/D within itself");
  ODMC_EXPECT_ERROR(parse("a/B again\n"), "has a/B within itself");
  ODMC_EXPECT_ERROR(parse("\x1b[31m red\n"), "\\x1b[31m red");
  ODMC_EXPECT_ERROR(parse(std::string(3 << 20, 'x')), "longer than any");
  ODMC_EXPECT_ERROR(MessageLayout("a b", ""), "is no name of a type");
  std::string deep = "c/T0 x\n";
  for (int i = 0; i < 100; ++i) {
    deep = With(deep, "c/T" + std::to_string(i), "c/T" + std::to_string(i + 1) + " x\n");
  }
  ODMC_EXPECT_ERROR(parse(With(deep, "c/T100", "bool x\n")), "too many messages within messages");
}

TEST(MessageLayout, SizesThatGrowWithoutBoundAreRefusedWithTheMessage) {
  std::string wide = "c/T0[1000000] x\n";
  for (int i = 0; i < 20; ++i) {
    wide = With(wide, "c/T" + std::to_string(i), "c/T" + std::to_string(i + 1) + "[1000000] x\n");
  }
  const MessageLayout layout("a/W", With(wide, "c/T20", "bool y\n"));
  ODMC_EXPECT_ERROR(Numbers(layout,
                            "x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[].x[]"
                            ".x[].x[].x[].x[].x[].y",
                            MessageBytes()),
                    "ends at byte 0");
}

// Whatever the bytes are, it ends, with an answer or a sentence.
TEST(MessageLayout, SurvivesGarbage) {
  std::mt19937 generator(3);
  const std::string esc = testing_support::EscStatusDefinition();
  const std::vector<std::uint8_t> sound = testing_support::EscStatus(1, {1, 2, 3, 4}).bytes();
  const MessageLayout layout("mavros_msgs/ESCStatus", esc);
  const FieldPath rpm = layout.Find("esc_status[].rpm");
  int refused = 0, answered = 0;
  for (int i = 0; i < 20000; ++i) {
    std::vector<std::uint8_t> bytes = sound;
    for (int k = 0; k < 3; ++k) bytes[generator() % bytes.size()] = generator() & 0xFF;
    bytes.resize(generator() % 4 == 0 ? generator() % sound.size() : sound.size());
    try {
      layout.Numbers(rpm, bytes.data(), bytes.size());
      ++answered;
    } catch (const std::invalid_argument&) {
      ++refused;
    }
  }
  for (int i = 0; i < 20000; ++i) {
    std::string text = esc;
    for (int k = 0; k < 4; ++k) text[generator() % text.size()] = static_cast<char>(generator());
    try {
      const MessageLayout spoiled("mavros_msgs/ESCStatus", text);
      spoiled.Numbers(spoiled.Find("esc_status[].rpm"), sound.data(), sound.size());
      ++answered;
    } catch (const std::invalid_argument&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 5000);
  EXPECT_GT(answered, 5000);
}

}  // namespace
}  // namespace odmc
