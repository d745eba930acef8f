#include "server/proxy/row_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<RowFile>> RowFile::Create(const std::string& file) {
  const int descriptor = open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (descriptor >= 0) return std::unique_ptr<RowFile>(new RowFile(file, descriptor));
  const int why = errno;
  if (why == EEXIST) {
    return absl::AlreadyExistsError(
        absl::StrCat(file, " is there: another run's record; give another --out"));
  }
  return absl::UnavailableError(absl::StrCat(file, ": ", std::strerror(why)));
}

RowFile::~RowFile() { close(descriptor_); }

absl::Status RowFile::Flush() {
  if (!failed_.ok()) return failed_;
  for (size_t at = 0; at < waiting_.size();) {
    const ssize_t written = write(descriptor_, waiting_.data() + at, waiting_.size() - at);
    if (written >= 0) {
      at += static_cast<size_t>(written);
      continue;
    }
    if (errno == EINTR) continue;
    failed_ = absl::UnavailableError(absl::StrCat(file_, ": ", std::strerror(errno)));
    if (ftruncate(descriptor_, size_) != 0)
      failed_ = absl::UnavailableError(
          absl::StrCat(failed_.message(), "; its last row may be cut: ", std::strerror(errno)));
    return failed_;
  }
  size_ += static_cast<int64_t>(waiting_.size());
  waiting_.clear();
  return absl::OkStatus();
}

}  // namespace robostress
