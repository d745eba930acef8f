#include "server/operations/process_metrics.h"

#include <sys/resource.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "common/version.h"

namespace robostress {
namespace {

std::string Contents(const char* file) {
  std::ifstream stream(file);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

// Fields of /proc/self/stat by their numbers in proc(5), from 3 on; the second may hold spaces.
class ProcessStat {
 public:
  ProcessStat() {
    const std::string text = Contents("/proc/self/stat");
    const size_t name_end = text.rfind(") ");
    if (name_end != std::string::npos) fields_ = absl::StrSplit(text.substr(name_end + 2), ' ');
  }
  double operator[](size_t field) const {
    double value = 0;
    return field - 3 < fields_.size() && absl::SimpleAtod(fields_[field - 3], &value) ? value : 0;
  }

 private:
  std::vector<std::string> fields_;
};

// [s] since 1970.
double BootTime() {
  const std::string text = Contents("/proc/stat");
  const size_t at = text.find("\nbtime ");
  double seconds = 0;
  if (at == std::string::npos) return 0;
  const size_t begin = at + 7;
  return absl::SimpleAtod(absl::string_view(text).substr(begin, text.find('\n', begin) - begin),
                          &seconds)
             ? seconds
             : 0;
}

double OpenDescriptors() {
  std::error_code error;
  double count = -1;  // that of the listing itself
  for (std::filesystem::directory_iterator at("/proc/self/fd", error), end; !error && at != end;
       at.increment(error))
    ++count;
  return std::max(0.0, count);
}

double MostDescriptors() {
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return 0;
  return static_cast<double>(limit.rlim_cur);
}

}  // namespace

void AddProcessMetrics(Metrics* metrics) {
  metrics
      ->AddGauge(
          "robostress_build_info", "1; what runs stands in the labels.",
          {{"version", BuildVersion()}, {"revision", BuildRevision()}, {"compiler", __VERSION__}})
      ->Set(1);
  const auto gauge = [metrics](const char* name, const char* help) {
    return metrics->AddGauge(name, help);
  };
  const double ticks = static_cast<double>(sysconf(_SC_CLK_TCK));
  const double page = static_cast<double>(sysconf(_SC_PAGESIZE));
  gauge("process_start_time_seconds", "Unix time at which the process was started.")
      ->Set(BootTime() + ProcessStat()[22] / ticks);
  const auto cpu =
      metrics->AddCounter("process_cpu_seconds_total", "Processor time in user and system mode.");
  const auto resident = gauge("process_resident_memory_bytes", "Memory in RAM.");
  const auto virtual_memory = gauge("process_virtual_memory_bytes", "Address space.");
  const auto threads = gauge("process_threads", "Threads now.");
  const auto open = gauge("process_open_fds", "Open file descriptors.");
  const auto most = gauge("process_max_fds", "File descriptors that may be open.");
  metrics->AddCollector([=] {
    const ProcessStat stat;
    cpu->Increment((stat[14] + stat[15]) / ticks - cpu->Value());  // ignores what is negative
    threads->Set(stat[20]);
    virtual_memory->Set(stat[23]);
    resident->Set(stat[24] * page);
    open->Set(OpenDescriptors());
    most->Set(MostDescriptors());
  });
}

void AddDiskMetrics(const std::string& folder, Metrics* metrics) {
  metrics->AddCollector([folder, metrics] {
    struct statvfs disk {};
    if (statvfs(folder.c_str(), &disk) != 0) return;
    const auto block = static_cast<double>(disk.f_frsize);
    metrics->AddGauge("robostress_state_dir_free_bytes", "Free for this server where sessions are.")
        ->Set(block * static_cast<double>(disk.f_bavail));
    metrics->AddGauge("robostress_state_dir_size_bytes", "Of the file system where sessions are.")
        ->Set(block * static_cast<double>(disk.f_blocks));
  });
}

}  // namespace robostress
