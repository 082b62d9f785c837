#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "odmc/io/foreign_messages.h"
#include "support/error_text.h"
#include "support/message_bytes.h"

namespace odmc {
namespace {

using testing_support::MessageBytes;
using testing_support::WithHeader;

constexpr double kRpm = M_PI / 30.0;
constexpr Stamp kArrival = 9000000000;

const MessageDescription kActuators = {"mav_msgs/Actuators", "25741daf38ed25442e3a66a855ee8d9c",
                                       testing_support::ActuatorsDefinition()};
const MessageDescription kEscStatus = {"mavros_msgs/ESCStatus", "145d49eaf5cfecbdfd50ae4a22fe82d4",
                                       testing_support::EscStatusDefinition()};
const MessageDescription kMotorRpm = {"blackbird/MotorRPM", "b5f09223542b26e832f8faf8e5bf6d22",
                                      testing_support::MotorRpmDefinition()};

std::optional<ForeignReading> Read(ForeignStream* stream, const MessageBytes& bytes) {
  return stream->Read(bytes.data(), bytes.size(), kArrival);
}

void ExpectNear(const std::vector<double>& a, const std::vector<double>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) EXPECT_NEAR(a[i], b[i], 1e-9 * (1.0 + std::abs(b[i])));
}

TEST(ForeignStream, KnowsActuatorsInRadiansPerSecond) {
  ForeignStream stream(ForeignUse::kRotorSpeeds, kActuators, {}, 4);
  const auto reading = Read(&stream, testing_support::Actuators(5, {700, -710, 720, -730}));
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->stamp, 5);
  ExpectNear(reading->values, {700, -710, 720, -730});
  EXPECT_TRUE(stream.TakeNotes().empty());
  EXPECT_EQ(stream.Describe(), "angular_velocities[] in rad_s, header.stamp");
}

// Until the ESCs have reported, the array is empty; there may be more ESCs than rotors.
TEST(ForeignStream, KnowsEscStatusInRpm) {
  ForeignStream stream(ForeignUse::kRotorSpeeds, kEscStatus, {}, 4);
  EXPECT_FALSE(Read(&stream, testing_support::EscStatus(5, {})));
  const auto reading = Read(&stream, testing_support::EscStatus(5, {6000, 6100, 6200, 6300, 0, 0}));
  ASSERT_TRUE(reading);
  ExpectNear(reading->values, {6000 * kRpm, 6100 * kRpm, 6200 * kRpm, 6300 * kRpm});
  const std::vector<std::string> notes = stream.TakeNotes();
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_TRUE(testing_support::Contains(notes[0], "has 6 entries, took the first 4")) << notes[0];
  Read(&stream, testing_support::EscStatus(6, {1, 2, 3, 4, 5, 6}));
  EXPECT_TRUE(stream.TakeNotes().empty());
  ODMC_EXPECT_ERROR(Read(&stream, testing_support::EscStatus(6, {1, 2, 3})),
                    "mavros_msgs/ESCStatus: esc_status[].rpm has 3 entries, the vehicle has 4");
}

TEST(ForeignStream, PutsRotorsInOrder) {
  FieldOptions options;
  options.order = ParseOrder("[2, 4, 1, 3]");
  ForeignStream stream(ForeignUse::kRotorSpeeds, kActuators, options, 4);
  ExpectNear(Read(&stream, testing_support::Actuators(5, {10, 20, 30, 40}))->values,
             {20, 40, 10, 30});
  ODMC_EXPECT_ERROR(Read(&stream, testing_support::Actuators(5, {10, 20, 30})),
                    "the order asks for entry 4");
  options.order = {1, 2, 3};
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, kActuators, options, 4),
                    "an order of 3 rotors was given, the vehicle has 4");
}

TEST(ForeignStream, ReadsAnyTypeByFieldAndUnit) {
  const MessageDescription made_up = {"my/Motors", "0123",
                                      "uint8 count\nuint16[4] erpm100\nstring name\n"};
  FieldOptions options;
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, made_up, options, 4),
                    "my/Motors is not known: say which of its fields holds rotor speeds "
                    "(rotor_topic_field");
  options.field = "erpm100[]";
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, made_up, options, 4),
                    "does not say in which unit erpm100[] is: give rotor_speed_unit");
  options.field = "name";
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, made_up, options, 4), "is text");
  options.field = "erpm100[]";
  options.unit = "erpm";
  options.pole_pairs = 7;
  ForeignStream stream(ForeignUse::kRotorSpeeds, made_up, options, 4);
  MessageBytes bytes;
  bytes.Add(std::uint8_t{4});
  for (const std::uint16_t value : {700, 1400, 2100, 2800}) bytes.Add(value);
  bytes.AddText("quad");
  const auto reading = Read(&stream, bytes);
  ExpectNear(reading->values, {100 * kRpm, 200 * kRpm, 300 * kRpm, 400 * kRpm});
  EXPECT_EQ(reading->stamp, kArrival);
  const std::vector<std::string> notes = stream.TakeNotes();
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_TRUE(testing_support::Contains(notes[0], "my/Motors has no stamp: took the time of"));
  options.unit = "furlongs";
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, made_up, options, 4),
                    "rotor_speed_unit must be");
}

TEST(ForeignStream, ArraysOfNumbersNeedAUnit) {
  const MessageDescription array = {
      "std_msgs/Float64MultiArray", "4b7d974086d4060e7db4613a7e6c3ba4",
      testing_support::With(
          testing_support::With("MultiArrayLayout layout\nfloat64[] data\n",
                                "std_msgs/MultiArrayLayout",
                                "MultiArrayDimension[] dim\nuint32 data_offset\n"),
          "std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n")};
  FieldOptions options;
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, array, options, 4), "in which unit");
  options.unit = "rpm";
  ForeignStream stream(ForeignUse::kRotorSpeeds, array, options, 4);
  MessageBytes bytes;
  bytes.Add(std::uint32_t{1}).AddText("rotors").Add(std::uint32_t{4}).Add(std::uint32_t{4});
  bytes.Add(std::uint32_t{0}).AddArray<double>({30, 60, 90, 120});
  ExpectNear(Read(&stream, bytes)->values, {M_PI, 2 * M_PI, 3 * M_PI, 4 * M_PI});
}

TEST(ForeignStream, SaysWhatIsNotAsKnown) {
  MessageDescription other = kActuators;
  other.md5 = "another";
  FieldOptions options;
  options.unit = "rpm";
  ForeignStream stream(ForeignUse::kRotorSpeeds, other, options, 4);
  const std::vector<std::string> notes = stream.TakeNotes();
  ASSERT_EQ(notes.size(), 2u);
  EXPECT_TRUE(testing_support::Contains(notes[0], "in rad_s, taken as rpm")) << notes[0];
  EXPECT_TRUE(testing_support::Contains(notes[1], "another version")) << notes[1];
}

TEST(ForeignStream, ZeroStampsGiveWayToTheTimeOfArrival) {
  ForeignStream stream(ForeignUse::kRotorSpeeds, kActuators, {}, 4);
  EXPECT_EQ(Read(&stream, testing_support::Actuators(0, {1, 2, 3, 4}))->stamp, kArrival);
  const std::vector<std::string> notes = stream.TakeNotes();
  ASSERT_EQ(notes.size(), 1u);
  EXPECT_TRUE(testing_support::Contains(notes[0], "headers without a stamp"));
}

// Speeds on straight lines over time come out on them, at one stamp.
TEST(ForeignStream, BringsSpeedsWithStampsOfTheirOwnToOne) {
  constexpr Stamp kMs = 1000000;
  ForeignStream stream(ForeignUse::kRotorSpeeds, kMotorRpm, {}, 4);
  const auto rpm_at = [](int rotor, Stamp stamp) {
    return 6000.0 + 100.0 * rotor + 1e-7 * (rotor + 1) * static_cast<double>(stamp);
  };
  int readings = 0;
  for (Stamp t = 0; t < 100 * kMs; t += 5 * kMs) {
    const std::vector<Stamp> stamps = {t + 2 * kMs, t, t + 3 * kMs, t + kMs};
    std::vector<float> rpm;
    for (int i = 0; i < 4; ++i) rpm.push_back(static_cast<float>(rpm_at(i, stamps[i])));
    const auto reading = Read(&stream, testing_support::MotorRpm(t + 50 * kMs, stamps, rpm));
    EXPECT_EQ(reading.has_value(), t > 0);
    if (!reading) continue;
    ++readings;
    EXPECT_EQ(reading->stamp, t);
    for (int i = 0; i < 4; ++i) EXPECT_NEAR(reading->values[i], rpm_at(i, t) * kRpm, 1e-4);
  }
  EXPECT_EQ(readings, 19);
  EXPECT_FALSE(Read(&stream, testing_support::MotorRpm(1, {0, 1, 2, 20 * kMs}, {1, 1, 1, 1})));
  ODMC_EXPECT_ERROR(Read(&stream, testing_support::MotorRpm(1, {0, 1}, {1, 1, 1, 1})),
                    "has 2 stamps for 4 entries of rpm[]");
}

// ---- Stamps of each rotor ----------------------------------------------------------------------

/// ESCs of nobody's package, each with its speed and when it read it.
std::string EscsDefinition(const std::string& stamp, bool has_header) {
  const std::string fields = "Esc[] escs\n";
  return testing_support::With(has_header ? WithHeader("Header header\n" + fields) : fields,
                               "my/Esc", stamp + " timestamp\nfloat64 rpm\n");
}

FieldOptions EscFields(const std::string& unit) {
  FieldOptions options;
  options.field = "escs[].rpm";
  options.unit = "rpm";
  options.stamp_field = "escs[].timestamp";
  options.stamp_unit = unit;
  return options;
}

double RpmAt(size_t rotor, Stamp stamp) {
  return 6000.0 + 100.0 * static_cast<double>(rotor) +
         (1.0 + static_cast<double>(rotor)) * 1e-7 * static_cast<double>(stamp);
}

/// Telemetry asks one ESC every 3 ms; each message repeats what the others said before, and comes
/// 1 to 5 ms late. `own_ns`: what the ESCs' clock reads when that of the messages is at 0.
struct InTurn {
  explicit InTurn(Stamp own) : own_ns(own), read(4, 0) {}

  MessageBytes Next(bool has_header, double ticks_per_ns) {
    const Stamp now = kArrival + 3000000 * static_cast<Stamp>(count);
    read[count % 4] = now;
    message_stamp = now + 1000000 + 1000000 * static_cast<Stamp>((7 * count) % 5);
    MessageBytes bytes;
    if (has_header) bytes.AddHeader(message_stamp, "");
    bytes.Add(std::uint32_t{4});
    for (size_t i = 0; i < 4; ++i) {
      const Stamp own = read[i] == 0 ? 0 : read[i] + own_ns;
      bytes.Add(static_cast<std::uint64_t>(std::llround(static_cast<double>(own) * ticks_per_ns)));
      bytes.Add(read[i] == 0 ? 0.0 : RpmAt(i, read[i]));
    }
    ++count;
    return bytes;
  }

  Stamp own_ns, message_stamp = 0;
  std::vector<Stamp> read;
  size_t count = 0;
};

// Microseconds since the flight controller's start, a while before the first message.
TEST(ForeignStream, BringsStampsOfEscsToOneTimeOfTheMessages) {
  const MessageDescription escs = {"my/Escs", "", EscsDefinition("uint64", true)};
  ForeignStream stream(ForeignUse::kRotorSpeeds, escs, EscFields("us"), 4);
  InTurn telemetry(-kArrival + 7000000000);
  int readings = 0;
  for (int i = 0; i < 200; ++i) {
    const MessageBytes bytes = telemetry.Next(true, 1e-3);
    const auto reading = stream.Read(bytes.data(), bytes.size(), kArrival);
    if (!reading) continue;
    ++readings;
    // The least delay is 1 ms, found once a message was so quick; the ESC read next is the oldest.
    const Stamp oldest = telemetry.read[telemetry.count % 4];
    if (i > 10) {
      EXPECT_NEAR(ToSeconds(reading->stamp - oldest), 0.001, 2e-5);
    }
    for (size_t j = 0; j < 4; ++j) {
      EXPECT_NEAR(reading->values[j], RpmAt(j, oldest) * kRpm, 2e-4 * kRpm);
    }
  }
  EXPECT_EQ(readings, 194);
  EXPECT_TRUE(stream.TakeNotes().empty());
  EXPECT_EQ(stream.StampSource(), "escs[].timestamp, a clock of its own laid on header.stamp");
}

// A date is no clock of its own: nothing is taken off it, however late the messages are.
TEST(ForeignStream, TakesDatesOfEscsAsTheyAre) {
  const Stamp date = 1600000000000000000;
  const MessageDescription escs = {"my/Escs", "", EscsDefinition("uint64", false)};
  ForeignStream stream(ForeignUse::kRotorSpeeds, escs, EscFields("us"), 4);
  InTurn telemetry(date - kArrival);
  for (int i = 0; i < 100; ++i) {
    const MessageBytes bytes = telemetry.Next(false, 1e-3);
    const Stamp arrival = telemetry.message_stamp + telemetry.own_ns + 200000000;
    const auto reading = stream.Read(bytes.data(), bytes.size(), arrival);
    if (!reading) continue;
    EXPECT_NEAR(ToSeconds(reading->stamp - date + kArrival - telemetry.read[telemetry.count % 4]),
                0.0, 1e-6);
  }
  EXPECT_EQ(stream.StampSource(), "escs[].timestamp");
}

TEST(ForeignStream, SaysWhatItsClockIsLaidOn) {
  const MessageDescription escs = {"my/Escs", "", EscsDefinition("uint64", false)};
  ForeignStream stream(ForeignUse::kRotorSpeeds, escs, EscFields("us"), 4);
  InTurn telemetry(-kArrival + 7000000000);
  for (int i = 0; i < 20; ++i) {
    const MessageBytes bytes = telemetry.Next(false, 1e-3);
    stream.Read(bytes.data(), bytes.size(), telemetry.message_stamp);
  }
  EXPECT_EQ(stream.StampSource(), "escs[].timestamp, a clock of its own laid on time of arrival");
  ASSERT_EQ(stream.TakeNotes().size(), 1u) << "the time of arrival is said";
}

TEST(ForeignStream, AsksForTheUnitOfStamps) {
  const MessageDescription numbers = {"my/Escs", "", EscsDefinition("uint64", true)};
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, numbers, EscFields("auto"), 4),
                    "my/Escs does not say in which unit escs[].timestamp is: give "
                    "rotor_stamp_unit (s, ms, us, ns)");
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, numbers, EscFields("hours"), 4),
                    "rotor_stamp_unit must be auto, s, ms, us or ns, not 'hours'");
  const MessageDescription texts = {"my/Escs", "", EscsDefinition("string", true)};
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, texts, EscFields("us"), 4), "is text");
  FieldOptions options = EscFields("us");
  options.stamp_field = "escs[].time";
  ODMC_EXPECT_ERROR(ForeignStream(ForeignUse::kRotorSpeeds, numbers, options, 4),
                    "there is no 'time' in my/Esc");
}

// A stamp of its own for the message as a whole, of ROS, beside a header of arrival.
TEST(ForeignStream, TakesOneStampForAllRotors) {
  const MessageDescription motors = {"my/Motors", "",
                                     WithHeader("Header header\ntime read\nfloat64[4] rpm\n")};
  FieldOptions options;
  options.field = "rpm[]";
  options.unit = "rpm";
  options.stamp_field = "read";
  ForeignStream stream(ForeignUse::kRotorSpeeds, motors, options, 4);
  for (Stamp t = 1000000; t < 10000000; t += 1000000) {
    MessageBytes bytes;
    bytes.AddHeader(t + 50000000, "").AddStamp(t);
    for (const double rpm : {10.0, 20.0, 30.0, 40.0}) bytes.Add(rpm);
    const auto reading = Read(&stream, bytes);
    ASSERT_TRUE(reading);
    EXPECT_EQ(reading->stamp, t);
    ExpectNear(reading->values, {10 * kRpm, 20 * kRpm, 30 * kRpm, 40 * kRpm});
  }
  EXPECT_EQ(stream.StampSource(), "read");
}

// Fields of a known type, with the stamps its entries carry.
TEST(ForeignStream, TakesStampsBesideAKnownField) {
  FieldOptions options;
  options.stamp_field = "esc_status[].header.stamp";
  ForeignStream stream(ForeignUse::kRotorSpeeds, kEscStatus, options, 4);
  const auto reading = Read(&stream, testing_support::EscStatus(5, {6000, 6000, 6000, 6000}));
  ASSERT_TRUE(reading);
  EXPECT_EQ(reading->stamp, 6) << "the ESCs' own, a nanosecond after the message's";
}

TEST(ForeignStream, TakesCommandsAsThrottle) {
  const MessageDescription rc_out = {"mavros_msgs/RCOut", "52cacf104bab5ae3b103cfe176590713",
                                     WithHeader("std_msgs/Header header\nuint16[] channels\n")};
  ForeignStream stream(ForeignUse::kCommands, rc_out, {}, 4);
  MessageBytes bytes;
  bytes.AddHeader(5).AddArray<std::uint16_t>({1000, 1250, 2000, 0, 1500, 900});
  ExpectNear(Read(&stream, bytes)->values, {0.0, 0.25, 1.0, 0.0});
  ODMC_EXPECT_ERROR(
      [&] {
        ForeignStream any(ForeignUse::kCommands, rc_out, {}, 0);
        Read(&any, bytes);
      }(),
      "say which of them are rotors by an order");
  ForeignStream normalized(ForeignUse::kCommands, kActuators, {}, 4);
  ExpectNear(Read(&normalized, testing_support::Actuators(1, {}, {0.1, 0.2, 0.3, 0.4}))->values,
             {0.1, 0.2, 0.3, 0.4});
}

TEST(ForeignStream, TakesTheVoltageOfOneEntry) {
  FieldOptions options;
  options.field = "esc_status[].voltage";
  ForeignStream many(ForeignUse::kVoltage, kEscStatus, options, 1);
  ODMC_EXPECT_ERROR(Read(&many, testing_support::EscStatus(5, {1, 2})),
                    "choose one, as esc_status[0]");
  options.field = "esc_status[0].voltage";
  ForeignStream one(ForeignUse::kVoltage, kEscStatus, options, 1);
  ExpectNear(Read(&one, testing_support::EscStatus(5, {1, 2}))->values, {15.5});
}

TEST(KnownMessages, HaveUnitsThatAreUnderstood) {
  std::set<std::pair<ForeignUse, std::string>> seen;
  for (const KnownMessage& known : KnownMessages()) {
    EXPECT_TRUE(seen.insert({known.use, known.type}).second) << known.type;
    EXPECT_TRUE(std::string(known.md5).empty() || std::string(known.md5).size() == 32)
        << known.type;
    EXPECT_TRUE(*known.unit != '\0' || known.by_name_only) << known.type;
    if (known.use == ForeignUse::kRotorSpeeds && *known.unit != '\0') {
      EXPECT_GT(RotorSpeedScale(known.unit, 7), 0.0);
    }
  }
  EXPECT_EQ(FindKnown(ForeignUse::kVoltage, "mav_msgs/Actuators"), nullptr);
}

TEST(ParseOrder, TakesListsOfEntries) {
  EXPECT_EQ(ParseOrder("2,4,1,3"), (std::vector<int>{2, 4, 1, 3}));
  EXPECT_EQ(ParseOrder("[2, 4, 1, 3]"), (std::vector<int>{2, 4, 1, 3}));
  EXPECT_EQ(ParseOrder(""), std::vector<int>());
  for (const char* text : {"0,1,2,3", "1,1,2,3", "a,b", "1,,2", "-1,2", "1.5", "99999"}) {
    ODMC_EXPECT_ERROR(ParseOrder(text), "is no order of rotors");
  }
}

}  // namespace
}  // namespace odmc
