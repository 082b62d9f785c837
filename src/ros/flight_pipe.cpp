#include "flight_pipe.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

namespace odmc {
namespace {

constexpr size_t kBuffer = 1 << 16;

/// One end of a pipe. Each kind of value has a Pass(), the same for both directions: PipeWriter
/// takes what it is shown, PipeReader fills it in.
class PipeWriter {
 public:
  explicit PipeWriter(int descriptor) : descriptor_(descriptor) { buffer_.reserve(kBuffer); }

  void Raw(void* data, size_t bytes) {
    if (buffer_.size() + bytes > kBuffer) Flush();
    const char* begin = static_cast<const char*>(data);
    buffer_.insert(buffer_.end(), begin, begin + bytes);
  }
  void Flush() {
    size_t done = 0;
    while (done < buffer_.size()) {
      const ssize_t count = write(descriptor_, buffer_.data() + done, buffer_.size() - done);
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) throw std::runtime_error("nobody reads the pipe");
      done += static_cast<size_t>(count);
    }
    buffer_.clear();
  }

 private:
  int descriptor_;
  std::vector<char> buffer_;
};

class PipeReader {
 public:
  explicit PipeReader(int descriptor) : descriptor_(descriptor), buffer_(kBuffer) {}

  void Raw(void* data, size_t bytes) {
    char* out = static_cast<char*>(data);
    while (bytes > 0) {
      if (next_ == end_) Fill();
      const size_t count = std::min(bytes, end_ - next_);
      std::memcpy(out, buffer_.data() + next_, count);
      next_ += count;
      out += count;
      bytes -= count;
    }
  }

 private:
  void Fill() {
    ssize_t count = 0;
    do {
      count = read(descriptor_, buffer_.data(), buffer_.size());
    } while (count < 0 && errno == EINTR);
    if (count <= 0) throw std::runtime_error("the pipe ended early");
    next_ = 0;
    end_ = static_cast<size_t>(count);
  }

  int descriptor_;
  std::vector<char> buffer_;
  size_t next_ = 0, end_ = 0;
};

template <typename Pipe, typename Number>
void PassNumber(Pipe* pipe, Number* number) {
  static_assert(std::is_arithmetic_v<Number> || std::is_enum_v<Number>);
  pipe->Raw(number, sizeof *number);
}

template <typename Pipe>
void Pass(Pipe* pipe, Eigen::Vector3d* v) {
  pipe->Raw(v->data(), 3 * sizeof(double));
}

template <typename Pipe>
void Pass(Pipe* pipe, std::optional<Eigen::Vector3d>* v) {
  bool has_value = v->has_value();
  PassNumber(pipe, &has_value);
  if (!has_value) return;
  if (!*v) v->emplace();
  Pass(pipe, &**v);
}

template <typename Pipe>
void Pass(Pipe* pipe, RotorVector* v) {
  auto size = static_cast<std::int32_t>(v->size());
  PassNumber(pipe, &size);
  if (size < 0 || size > kMaxRotors) throw std::runtime_error("a number of rotors that is none");
  if (v->size() != size) v->resize(size);
  pipe->Raw(v->data(), static_cast<size_t>(size) * sizeof(double));
}

template <typename Pipe>
void Pass(Pipe* pipe, OdometrySample* s) {
  PassNumber(pipe, &s->stamp);
  Pass(pipe, &s->p_WS);
  pipe->Raw(s->q_WS.coeffs().data(), 4 * sizeof(double));
  Pass(pipe, &s->v_WS);
  Pass(pipe, &s->w_WS_S);
}

template <typename Pipe>
void Pass(Pipe* pipe, ImuSample* s) {
  PassNumber(pipe, &s->stamp);
  Pass(pipe, &s->gyro_I);
  Pass(pipe, &s->specific_force_I);
}

template <typename Pipe>
void Pass(Pipe* pipe, RotorSample* s) {
  PassNumber(pipe, &s->stamp);
  Pass(pipe, &s->speed);
  Pass(pipe, &s->model_sigma);
}

template <typename Pipe>
void Pass(Pipe* pipe, BatterySample* s) {
  PassNumber(pipe, &s->stamp);
  PassNumber(pipe, &s->voltage_V);
}

template <typename Pipe>
void Pass(Pipe* pipe, CommandSample* s) {
  PassNumber(pipe, &s->stamp);
  Pass(pipe, &s->throttle);
}

template <typename Pipe>
void Pass(Pipe* pipe, std::string* text) {
  auto size = static_cast<std::uint32_t>(text->size());
  PassNumber(pipe, &size);
  text->resize(size);
  for (size_t at = 0; at < size; at += kBuffer) {
    pipe->Raw(text->data() + at, std::min(kBuffer, size - at));
  }
}

template <typename Pipe, typename Value>
void Pass(Pipe* pipe, std::vector<Value>* values) {
  auto size = static_cast<std::uint64_t>(values->size());
  PassNumber(pipe, &size);
  values->resize(size);
  for (Value& value : *values) Pass(pipe, &value);
}

template <typename Pipe>
void PassFlight(Pipe* pipe, FlightLog* log) {
  // The names keep this list whole: a new member of FlightLog does not compile here.
  auto& [file, odometry, imu, rotors, battery, commands, command_unit, rotor_rms_only, dropped,
         warnings] = *log;
  Pass(pipe, &file);
  Pass(pipe, &odometry);
  Pass(pipe, &imu);
  Pass(pipe, &rotors);
  Pass(pipe, &battery);
  Pass(pipe, &commands);
  PassNumber(pipe, &command_unit);
  PassNumber(pipe, &rotor_rms_only);
  PassNumber(pipe, &dropped);
  Pass(pipe, &warnings);
}

}  // namespace

void SendFlight(FlightAnswer answer, int descriptor) {
  PipeWriter pipe(descriptor);
  Pass(&pipe, &answer.error);
  PassFlight(&pipe, &answer.log);
  pipe.Flush();
}

FlightAnswer ReceiveFlight(int descriptor) {
  PipeReader pipe(descriptor);
  FlightAnswer answer;
  Pass(&pipe, &answer.error);
  PassFlight(&pipe, &answer.log);
  return answer;
}

}  // namespace odmc
