#include "child_reader.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <new>
#include <optional>
#include <stdexcept>
#include <utility>

#include "flight_pipe.h"

namespace odmc {
namespace {

/// Lowers a soft limit; the hard one stays where it is.
void SetLimit(int resource, std::uint64_t wanted) {
  rlimit limit{};
  if (getrlimit(static_cast<__rlimit_resource>(resource), &limit) != 0) return;
  limit.rlim_cur = std::min<rlim_t>(wanted, limit.rlim_max);
  setrlimit(static_cast<__rlimit_resource>(resource), &limit);
}

std::uint64_t AddressSpace() {
  std::uint64_t pages = 0;
  std::ifstream("/proc/self/statm") >> pages;
  return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

std::uint64_t CpuSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec);
}

/// The child's own life: nothing on the terminal, no core file, and an end with its parent's.
void PrepareChild(pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  SetLimit(RLIMIT_CORE, 0);
  const int nowhere = open("/dev/null", O_RDWR | O_CLOEXEC);
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) dup2(nowhere, stream);
}

[[noreturn]] void LiveAsChild(const std::function<FlightLog()>& read, int descriptor) {
  FlightAnswer answer;
  try {
    answer.log = read();
  } catch (const std::exception& e) {
    answer.error = e.what();
    answer.log = FlightLog();
  }
  try {
    SendFlight(std::move(answer), descriptor);
  } catch (const std::exception&) {
    _exit(1);
  }
  _exit(0);
}

/// Waits for the end of a child. @returns its status as of waitpid()
int EndOf(pid_t child) {
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return status;
}

[[noreturn]] void FailFor(const std::string& file, int status) {
  const bool took_long = WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU;
  throw std::invalid_argument(
      file +
      (took_long ? ": reading takes longer than a sound file of its size ever would"
                 : ": the bag library crashed while reading it") +
      ": the file is damaged (`rosbag reindex` or `rosbag fix` may rescue what is there)");
}

}  // namespace

void Restrict(const ChildLimits& limits) {
  SetLimit(RLIMIT_AS, AddressSpace() + limits.memory_bytes);
  SetLimit(RLIMIT_CPU, CpuSeconds() + std::max<std::uint64_t>(1, limits.cpu_s));
}

FlightLog ReadInChild(const std::string& file, const std::function<FlightLog()>& read) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error(file + ": no pipe to be had");
  const pid_t parent = getpid();
  const pid_t child = fork();
  if (child == 0) {
    close(ends[0]);
    PrepareChild(parent);
    LiveAsChild(read, ends[1]);
  }
  close(ends[1]);
  if (child < 0) {
    close(ends[0]);
    throw std::runtime_error(file + ": no process to be had to read it");
  }
  std::optional<FlightAnswer> answer;
  bool fits = true;
  try {
    answer = ReceiveFlight(ends[0]);
  } catch (const std::bad_alloc&) {
    fits = false;
  } catch (const std::exception&) {  // the child's end says why
  }
  close(ends[0]);
  const int status = EndOf(child);
  if (!fits) throw std::bad_alloc();
  if (!answer || status != 0) FailFor(file, status);
  if (!answer->error.empty()) throw std::invalid_argument(answer->error);
  return std::move(answer->log);
}

}  // namespace odmc
