#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <sstream>

#include "odmc/io/autopilot_logs.h"
#include "odmc/io/flight_csv.h"
#include "support/error_text.h"
#include "support/recorded_data.h"
#include "support/temporary_folder.h"

namespace odmc {
namespace {

using testing_support::Contains;
using testing_support::TemporaryFolder;

/// How a test's log has one field: predictors and encodings by their numbers in the header.
struct FieldDefinition {
  std::string name;
  bool is_signed;
  int predictor_i, encoding_i, predictor_p, encoding_p;
};

/// Writes a blackbox log frame by frame, as the firmware does: each value less its prediction, in
/// the encoding of its field.
class BlackboxWriter {
 public:
  explicit BlackboxWriter(std::vector<FieldDefinition> fields) : fields_(std::move(fields)) {
    Line("Product", "Blackbox flight data recorder by Nicholas Sherlock");
    Line("Data version", "2");
    Line("Field I name", List([](const FieldDefinition& f) { return f.name; }));
    Line("Field I signed", List([](const FieldDefinition& f) { return f.is_signed ? "1" : "0"; }));
    const auto number = [](int i) { return std::to_string(i); };
    Line("Field I predictor", List([&](const auto& f) { return number(f.predictor_i); }));
    Line("Field I encoding", List([&](const auto& f) { return number(f.encoding_i); }));
    Line("Field P predictor", List([&](const auto& f) { return number(f.predictor_p); }));
    Line("Field P encoding", List([&](const auto& f) { return number(f.encoding_p); }));
    Line("Field S name", "flightModeFlags,a,b,c");
    Line("Field S signed", "0,0,0,0");
    Line("Field S predictor", "0,0,0,0");
    Line("Field S encoding", "1,7,7,7");
    Line("Firmware revision", "Testflight 1.0");
  }

  void Line(const std::string& name, const std::string& value) {
    text_ += "H " + name + ":" + value + "\n";
  }

  /// A main frame of these values, full (I) or against the frames before it (P).
  void Frame(bool is_full, const std::vector<std::int64_t>& values) {
    text_ += is_full ? 'I' : 'P';
    std::vector<std::int64_t> rest;
    std::vector<int> encodings;
    for (size_t i = 0; i < fields_.size(); ++i) {
      rest.push_back(values[i] - Prediction(is_full, i, values));
      encodings.push_back(is_full ? fields_[i].encoding_i : fields_[i].encoding_p);
    }
    for (size_t i = 0; i < rest.size();) i += Encode(encodings, rest, i);
    last_but_one_ = is_full ? values : last_;
    last_ = values;
  }

  void SlowFrame() { text_ += std::string("S") + '\x05' + '\x15'; }  // 2 bits each
  void FlightModeEvent() { text_ += std::string("E") + char(30) + '\x01' + '\x02'; }
  void End() { text_ += std::string("E") + char(255) + std::string("End of log\0", 11); }

  const std::string& text() const { return text_; }

 private:
  template <typename Get>
  std::string List(Get get) const {
    std::string list;
    for (const FieldDefinition& field : fields_)
      list += (list.empty() ? "" : ",") + std::string(get(field));
    return list;
  }

  std::int64_t Prediction(bool is_full, size_t i, const std::vector<std::int64_t>& values) const {
    switch (is_full ? fields_[i].predictor_i : fields_[i].predictor_p) {
      case 1:
        return last_[i];
      case 2:
        return 2 * last_[i] - last_but_one_[i];
      case 3:
        return (last_[i] + last_but_one_[i]) / 2;
      case 5:
        for (size_t k = 0; k < i; ++k) {
          if (fields_[k].name == "motor[0]") return values[k];
        }
        return 0;
      case 6:
        return last_[i] + 2;  // every second loop is logged
      case 8:
        return 1500;
      case 11:
        return 158;
      default:
        return 0;
    }
  }

  void Unsigned(std::uint32_t value) {
    for (; value > 127; value >>= 7) text_ += static_cast<char>(value | 0x80);
    text_ += static_cast<char>(value);
  }
  void Signed(std::int64_t value) {
    const auto word = static_cast<std::uint32_t>(value);
    Unsigned((word << 1) ^ (value < 0 ? ~0u : 0u));
  }
  static int Bits(std::int64_t value) {  // two's complement
    int bits = 1;
    while (value < -(std::int64_t{1} << (bits - 1)) || value >= (std::int64_t{1} << (bits - 1)))
      ++bits;
    return bits;
  }

  size_t Encode(const std::vector<int>& encodings, const std::vector<std::int64_t>& v, size_t i) {
    switch (encodings[i]) {
      case 0:
        Signed(v[i]);
        return 1;
      case 1:
        Unsigned(static_cast<std::uint32_t>(v[i]));
        return 1;
      case 3:
        Unsigned(static_cast<std::uint32_t>(-v[i]) & 0x3fff);
        return 1;
      case 6:
        return Tag8(encodings, v, i);
      case 7:
        Tag2(v, i);
        return 3;
      case 8:
        Tag84(v, i);
        return 4;
      case 10:
        Tag2Variable(v, i);
        return 3;
      default:
        return 1;
    }
  }

  size_t Tag8(const std::vector<int>& encodings, const std::vector<std::int64_t>& v, size_t i) {
    size_t count = 1;
    while (count < 8 && i + count < v.size() && encodings[i + count] == 6) ++count;
    int tag = 0;
    for (size_t k = 0; k < count; ++k) tag |= (v[i + k] != 0 ? 1 : 0) << k;
    if (count > 1) text_ += static_cast<char>(tag);
    for (size_t k = 0; k < count; ++k) {
      if (count == 1 || v[i + k] != 0) Signed(v[i + k]);
    }
    return count;
  }

  void Tag2(const std::vector<std::int64_t>& v, size_t i) {
    const int bits = std::max({Bits(v[i]), Bits(v[i + 1]), Bits(v[i + 2])});
    if (bits <= 2) {
      text_ += static_cast<char>((v[i] & 3) << 4 | (v[i + 1] & 3) << 2 | (v[i + 2] & 3));
    } else if (bits <= 4) {
      text_ += static_cast<char>(0x40 | (v[i] & 15));
      text_ += static_cast<char>((v[i + 1] & 15) << 4 | (v[i + 2] & 15));
    } else if (bits <= 6) {
      text_ += static_cast<char>(0x80 | (v[i] & 63));
      text_ += static_cast<char>(v[i + 1] & 63);
      text_ += static_cast<char>(v[i + 2] & 63);
    } else {
      Tag2OfBytes(v, i);
    }
  }

  /// Two bits each where they suffice, else bytes.
  void Tag2OfBytes(const std::vector<std::int64_t>& v, size_t i) {
    if (std::max({Bits(v[i]), Bits(v[i + 1]), Bits(v[i + 2])}) <= 2) {
      text_ += static_cast<char>((v[i] & 3) << 4 | (v[i + 1] & 3) << 2 | (v[i + 2] & 3));
      return;
    }
    int tag = 0xc0;
    for (int k = 0; k < 3; ++k) tag |= (Bytes(v[i + static_cast<size_t>(k)]) - 1) << 2 * k;
    text_ += static_cast<char>(tag);
    for (size_t k = 0; k < 3; ++k) {
      for (int b = 0; b < Bytes(v[i + k]); ++b) text_ += static_cast<char>(v[i + k] >> 8 * b);
    }
  }

  void Tag2Variable(const std::vector<std::int64_t>& v, size_t i) {
    const int a = Bits(v[i]), b = Bits(v[i + 1]), c = Bits(v[i + 2]);
    const auto lowest = [&](size_t k, int bits) {
      return static_cast<std::uint32_t>(v[i + k]) & ((1u << bits) - 1);
    };
    if (std::max({a, b, c}) > 2 && a <= 5 && b <= 5 && c <= 4) {
      const std::uint32_t word = 1u << 14 | lowest(0, 5) << 9 | lowest(1, 5) << 4 | lowest(2, 4);
      text_ += static_cast<char>(word >> 8);
      text_ += static_cast<char>(word);
    } else if (std::max({a, b, c}) > 2 && a <= 8 && b <= 7 && c <= 7) {
      const std::uint32_t word = 2u << 22 | lowest(0, 8) << 14 | lowest(1, 7) << 7 | lowest(2, 7);
      for (const int shift : {16, 8, 0}) text_ += static_cast<char>(word >> shift);
    } else {
      Tag2OfBytes(v, i);
    }
  }

  static int Bytes(std::int64_t value) { return (Bits(value) + 7) / 8; }

  void Tag84(const std::vector<std::int64_t>& v, size_t i) {
    int tag = 0;
    std::vector<int> nibbles;
    for (int k = 0; k < 4; ++k) {
      const std::int64_t value = v[i + static_cast<size_t>(k)];
      const int size = value == 0 ? 0 : Bits(value) <= 4 ? 1 : Bits(value) <= 8 ? 2 : 3;
      tag |= size << 2 * k;
      for (int n = size == 3 ? 3 : size - 1; n >= 0; --n) {
        nibbles.push_back(static_cast<int>(value >> 4 * n) & 15);
      }
    }
    if (nibbles.size() % 2 != 0) nibbles.push_back(0);
    text_ += static_cast<char>(tag);
    for (size_t n = 0; n < nibbles.size(); n += 2) {
      text_ += static_cast<char>(nibbles[n] << 4 | nibbles[n + 1]);
    }
  }

  std::vector<FieldDefinition> fields_;
  std::vector<std::int64_t> last_, last_but_one_;
  std::string text_;
};

/// Fields with every predictor and encoding that firmware uses, INDIflight's pose among them.
std::vector<FieldDefinition> FlightFields() {
  std::vector<FieldDefinition> fields = {{"loopIteration", false, 0, 1, 6, 9},
                                         {"time", false, 0, 1, 2, 0}};
  const auto add = [&](const std::string& name, int count, bool is_signed, int predictor_i,
                       int encoding_i, int predictor_p, int encoding_p) {
    for (int i = 0; i < count; ++i) {
      fields.push_back({name + "[" + std::to_string(i) + "]", is_signed, predictor_i, encoding_i,
                        predictor_p, encoding_p});
    }
  };
  add("gyroADC", 3, true, 0, 0, 3, 7);
  add("rcCommand", 4, true, 0, 0, 1, 8);
  add("accSmooth", 3, true, 0, 0, 3, 10);
  fields.push_back({"motor[0]", false, 11, 1, 3, 0});
  for (int i = 1; i < 4; ++i) {
    fields.push_back({"motor[" + std::to_string(i) + "]", false, 5, 0, 3, 0});
  }
  fields.push_back({"vbatLatest", false, 0, 3, 1, 6});
  add("quat", 4, true, 0, 0, 1, 6);
  add("pos", 3, true, 0, 0, 1, 0);
  add("vel", 3, true, 0, 0, 1, 7);
  add("eRPM", 4, false, 0, 1, 1, 0);
  return fields;
}

/// A frame of a made-up flight: everything moves, slowly and in leaps that need all lengths.
std::vector<std::int64_t> ValuesAt(int i) {
  const double t = 0.004 * i;
  const auto wave = [&](double size, double phase) {
    return std::lround(size * std::sin(2.0 * t + phase));
  };
  const std::int64_t leap = i % 7 == 0 ? 40000 : i % 5 == 0 ? 90 : i % 3 == 0 ? 3 : 0;
  std::vector<std::int64_t> v = {2 * i, 5000000 + 4000 * i};
  for (int k = 0; k < 3; ++k) v.push_back(wave(300, k) + (k == 1 ? leap / 20 : 0));
  for (int k = 0; k < 4; ++k) v.push_back(wave(100, k) + (k == 2 ? leap / 10 : 0) - 50);
  v.insert(v.end(), {wave(200, 0), wave(100, 1) + (i % 11 == 0 ? 45 : 0),
                     2048 + wave(300, 2) + (i % 13 == 0 ? 400 : 0)});
  for (int k = 0; k < 4; ++k) v.push_back(800 + wave(100, k));
  v.push_back(1600 - i / 50);
  const double half_yaw = 0.3 * std::sin(t);
  v.insert(v.end(),
           {std::lround(8127 * std::cos(half_yaw)), 0, 0, std::lround(8127 * std::sin(half_yaw))});
  v.insert(v.end(), {wave(2000, 0.5), wave(1000, 1.0), -1500 + wave(500, 1.5)});
  v.insert(v.end(), {wave(200, 2.0), wave(100, 2.5) + leap / 100, wave(50, 3.0)});
  for (int k = 0; k < 4; ++k) v.push_back(1200 + wave(200, k));
  return v;
}

constexpr int kFrames = 400;

std::string MadeUpLog(bool with_pose = true) {
  std::vector<FieldDefinition> fields = FlightFields();
  const size_t pose = 17, end = 27;  // quat, pos, vel
  if (!with_pose) fields.erase(fields.begin() + pose, fields.begin() + end);
  BlackboxWriter writer(fields);
  for (const auto& [name, value] :
       std::vector<std::pair<std::string, std::string>>{{"I interval", "32"},
                                                        {"P interval", "1/2"},
                                                        {"motorOutput", "158,2047"},
                                                        {"acc_1G", "2048"},
                                                        {"motor_poles", "12"},
                                                        {"minthrottle", "1070"}}) {
    writer.Line(name, value);
  }
  for (int i = 0; i < kFrames; ++i) {
    std::vector<std::int64_t> values = ValuesAt(i);
    if (!with_pose) values.erase(values.begin() + pose, values.begin() + end);
    if (i % 100 == 50) writer.SlowFrame();
    if (i % 100 == 70) writer.FlightModeEvent();
    writer.Frame(i % 16 == 0, values);
  }
  writer.End();
  return writer.text();
}

class Blackbox : public ::testing::Test {
 protected:
  FlightLog Read(const std::string& text, FlightReadOptions options = {}) const {
    return ReadBlackbox(folder_.Write("flight.bfl", text), options);
  }
  TemporaryFolder folder_;
};

TEST_F(Blackbox, GivesEveryValueBackInOurFramesAndUnits) {
  const FlightLog log = Read(MadeUpLog());
  ASSERT_EQ(log.odometry.size(), static_cast<size_t>(kFrames));
  ASSERT_EQ(log.rotors.size(), static_cast<size_t>(kFrames));
  ASSERT_EQ(log.imu.size(), static_cast<size_t>(kFrames));
  EXPECT_EQ(log.dropped, 0);
  for (int i = 0; i < kFrames; ++i) {
    const auto row = static_cast<size_t>(i);
    const std::vector<std::int64_t> v = ValuesAt(i);
    const auto value = [&](int field) {
      return static_cast<double>(v[static_cast<size_t>(field)]);
    };
    const OdometrySample& pose = log.odometry[row];
    ASSERT_EQ(pose.stamp, 1000 * v[1]) << i;
    EXPECT_TRUE(
        pose.p_WS.isApprox(1e-3 * Eigen::Vector3d(value(21), -value(22), -value(23)), 1e-12));
    EXPECT_TRUE(
        pose.v_WS->isApprox(1e-2 * Eigen::Vector3d(value(24), -value(25), -value(26)), 1e-12))
        << i << ": " << pose.v_WS->transpose();
    EXPECT_NEAR(pose.q_WS.z() / pose.q_WS.w(), -value(20) / value(17), 1e-12);  // yaw the other way
    const Eigen::Vector3d gyro = M_PI / 180.0 * Eigen::Vector3d(value(2), value(3), value(4));
    EXPECT_TRUE(log.imu[row].gyro_I->isApprox(gyro, 1e-12)) << i;
    const Eigen::Vector3d acc(value(9), value(10), value(11));
    EXPECT_TRUE(log.imu[row].specific_force_I->isApprox(9.80665 / 2048 * acc, 1e-12)) << i;
    for (int j = 0; j < 4; ++j) {
      EXPECT_NEAR(log.rotors[row].speed[j], value(27 + j) * 100.0 / 6.0 * M_PI / 30.0, 1e-9);
      EXPECT_NEAR(log.commands[row].throttle[j], (value(12 + j) - 158.0) / (2047.0 - 158.0), 1e-12);
    }
    EXPECT_NEAR(log.battery[row].voltage_V, 0.01 * value(16), 1e-9);
  }
  EXPECT_TRUE(Contains(log.warnings.back(), "read pose 250 Hz, IMU 250 Hz, rotor speeds 250 Hz"))
      << log.warnings.back();
}

TEST_F(Blackbox, PolePairsOfTheUserReplaceTheHeaders) {
  FlightReadOptions options;
  options.pole_pairs = 7;
  EXPECT_NEAR(Read(MadeUpLog(), options).rotors[0].speed[0] * 7.0,
              Read(MadeUpLog()).rotors[0].speed[0] * 6.0, 1e-9);
}

TEST_F(Blackbox, RefusesALogWithoutPoseAndSaysWhatIsMissing) {
  ODMC_EXPECT_ERROR(Read(MadeUpLog(false)), "(Testflight 1.0) has no pose");
  ODMC_EXPECT_ERROR(Read(MadeUpLog(false)), "--odometry FILE");
}

TEST_F(Blackbox, ReadsTheLongestOfSeveralLogs) {
  const std::string whole = MadeUpLog();
  const FlightLog log =
      Read(whole.substr(0, whole.size() / 3) + whole + whole.substr(0, whole.size() / 2));
  EXPECT_EQ(log.odometry.size(), static_cast<size_t>(kFrames));
  EXPECT_TRUE(Contains(log.warnings[0], "holds 3 logs; read the longest, number 2"));
}

TEST_F(Blackbox, TruncatedAnywhereGivesWhatIsThereOrASentence) {
  const std::string whole = MadeUpLog();
  size_t last = 0;
  for (size_t length = 1; length < whole.size(); length += 97) {
    try {
      const FlightLog log = Read(whole.substr(0, length));
      EXPECT_GE(log.odometry.size(), last);
      last = log.odometry.size();
      EXPECT_TRUE(Contains(log.warnings[0], "ends within a record: cut off")) << log.warnings[0];
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.bfl: ")) << e.what();
      EXPECT_EQ(last, 0u) << length << ": " << e.what();
    }
  }
  EXPECT_GT(last, 350u);
  ODMC_EXPECT_ERROR(Read(whole.substr(0, 100)), "byte 78: the blackbox header is cut off");
}

TEST_F(Blackbox, DamagedBytesCostFewFramesAndNoWrongTime) {
  const std::string whole = MadeUpLog();
  const size_t begin = whole.find("minthrottle:1070\n") + 17;
  for (size_t at = begin; at < whole.size(); at += 53) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 8));
    const FlightLog log = Read(damaged);
    EXPECT_GE(log.odometry.size(), static_cast<size_t>(kFrames - 40)) << at;
    for (size_t i = 1; i < log.odometry.size(); ++i) {
      ASSERT_GT(log.odometry[i].stamp, log.odometry[i - 1].stamp) << at;
    }
  }
}

TEST_F(Blackbox, DamagedHeadersAreSentencesNotCrashes) {
  const std::string whole = MadeUpLog();
  const size_t end = whole.find("minthrottle:1070\n");
  for (size_t at = 0; at < end; at += 3) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 7));
    try {
      Read(damaged);
    } catch (const std::invalid_argument& e) {
      EXPECT_TRUE(Contains(e.what(), "flight.bfl: ")) << e.what();
    }
  }
}

TEST_F(Blackbox, SingleLeapsOfARotorAreDroppedAndCounted) {
  BlackboxWriter writer(FlightFields());
  writer.Line("motor_poles", "12");
  writer.Line("P interval", "1/2");
  for (int i = 0; i < 100; ++i) {
    std::vector<std::int64_t> values = ValuesAt(i);
    if (i == 40) values[28] *= 2.5;
    if (i == 60) values[29] = 0;
    writer.Frame(i % 16 == 0, values);
  }
  writer.End();
  const FlightLog log = Read(writer.text());
  EXPECT_EQ(log.rotors.size(), 98u);
  EXPECT_EQ(log.dropped, 2);
  EXPECT_TRUE(Contains(log.warnings.back(), "dropped 2 readings in which a rotor leaps"));
}

TEST_F(Blackbox, RefusesASlowLogWithTheSettingThatMendsIt) {
  BlackboxWriter writer(FlightFields());
  writer.Line("motor_poles", "12");
  for (int i = 0; i < 100; ++i) {
    std::vector<std::int64_t> values = ValuesAt(i);
    values[1] = 5000000 + 40000 * i;
    writer.Frame(true, values);
  }
  writer.End();
  ODMC_EXPECT_ERROR(Read(writer.text()), "rotor speeds are logged at 25 Hz, at least 50 Hz");
  ODMC_EXPECT_ERROR(Read(writer.text()), "blackbox_sample_rate");
}

/// The CSV made from a log is a part of it: every row is found at its time.
void ExpectSamePart(const FlightLog& log, const FlightLog& csv) {
  constexpr size_t kRowsThatTell = 50;
  const auto fits = [&](size_t from) {
    for (size_t i = 0; i < kRowsThatTell; ++i) {
      if ((log.odometry[from + i].p_WS - csv.odometry[i].p_WS).norm() > 1e-9) return false;
    }
    return true;
  };
  size_t first = 0;
  while (first + kRowsThatTell < log.odometry.size() && !fits(first)) ++first;
  ASSERT_LE(first + csv.odometry.size(), log.odometry.size());
  const Stamp zero = log.odometry[first].stamp;
  for (size_t i = 0; i < csv.odometry.size(); ++i) {
    const OdometrySample &a = log.odometry[first + i], &b = csv.odometry[i];
    ASSERT_NEAR(ToSeconds(a.stamp - zero), ToSeconds(b.stamp), 6e-5) << i;
    ASSERT_LT((a.p_WS - b.p_WS).norm(), 1e-9) << i;
    ASSERT_LT((*a.v_WS - *b.v_WS).norm(), 1e-9) << i;
    ASSERT_LT(a.q_WS.angularDistance(b.q_WS), 3e-4) << i;
    ASSERT_LT((*log.imu[first + i].gyro_I - *csv.imu[i].gyro_I).norm(), 1e-4) << i;
    ASSERT_LT((*log.imu[first + i].specific_force_I - *csv.imu[i].specific_force_I).norm(), 2e-3)
        << i;
    ASSERT_EQ(log.rotors[first + i].speed, csv.rotors[i].speed) << i;
    ASSERT_LT((log.commands[first + i].throttle - csv.commands[i].throttle).norm(), 2e-4) << i;
  }
}

TEST(RecordedBlackbox, IsTheFlightOfTheCsvMadeFromIt) {
  for (const char* name : {"LOG00231", "LOG00267", "LOG00273"}) {
    const std::string raw = test::RecordedFile(std::string("indiflight/raw/") + name + ".BFL");
    const std::string csv = test::RecordedFile(std::string("indiflight/") + name + ".csv");
    if (raw.empty() || csv.empty()) GTEST_SKIP() << "no recorded data";
    const auto start = std::chrono::steady_clock::now();
    const FlightLog log = ReadBlackbox(raw, {});
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    EXPECT_LT(took.count(), 1.0);
    EXPECT_EQ(log.dropped, 0) << log.warnings[0];
    ExpectSamePart(log, ReadFlightCsv(csv, 4, PoseSource::kEkf));
  }
}

}  // namespace
}  // namespace odmc
