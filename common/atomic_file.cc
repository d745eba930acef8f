#include "common/atomic_file.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <memory>

#include "absl/functional/function_ref.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_stream.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

class FileDescriptor {
 public:
  explicit FileDescriptor(int fd) : fd_(fd) {}
  ~FileDescriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

// Hands the file to `take` in order, block by block.
absl::Status ReadBlocks(const std::string& path, absl::FunctionRef<void(std::string_view)> take) {
  const FileDescriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) return ErrnoStatus("cannot open", path, errno);
  char buffer[1 << 16];
  while (true) {
    const ssize_t count = ::read(file.get(), buffer, sizeof(buffer));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return ErrnoStatus("cannot read", path, errno);
    if (count == 0) return absl::OkStatus();
    take(std::string_view(buffer, static_cast<size_t>(count)));
  }
}

std::string Hex(const unsigned char* digest, unsigned int size) {
  return absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(digest), size));
}

}  // namespace

absl::Status WriteFileAtomically(const std::string& path, std::string_view contents) {
  RS_ASSIGN_OR_RETURN(AtomicStream file, AtomicStream::Create(path));
  RS_RETURN_IF_ERROR(file.Append(contents));
  return file.Publish();
}

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  std::string contents;
  RS_RETURN_IF_ERROR(
      ReadBlocks(path, [&contents](std::string_view block) { contents.append(block); }));
  return contents;
}

absl::StatusOr<std::string> ReadFileUpTo(const std::string& path, uint64_t max_bytes) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0) return ErrnoStatus("cannot open", path, errno);
  if (!S_ISREG(info.st_mode))
    return absl::InvalidArgumentError(absl::StrCat(path, ": is not a regular file"));
  if (static_cast<uint64_t>(info.st_size) > max_bytes) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has ", info.st_size, " bytes, the limit is ", max_bytes));
  }
  return ReadFile(path);
}

absl::Status AppendLine(const std::string& path, std::string_view line) {
  FileDescriptor file(::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
  if (file.get() < 0) return ErrnoStatus("cannot open", path, errno);
  struct stat before {};
  if (::fstat(file.get(), &before) != 0) return ErrnoStatus("cannot stat", path, errno);
  absl::Status status = WriteAll(file.get(), std::string(line) + "\n", path);
  if (status.ok() && ::fsync(file.get()) != 0) status = ErrnoStatus("cannot sync", path, errno);
  if (!status.ok() && ::ftruncate(file.get(), before.st_size) != 0) {
    return absl::DataLossError(absl::StrCat(status.message(), "; a part of the line may remain"));
  }
  return status;
}

absl::Status MakeDirectories(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error) return ErrnoStatus("cannot create directory", path, error.value());
  return absl::OkStatus();
}

std::string Sha256Hex(std::string_view bytes) {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  EVP_Digest(bytes.data(), bytes.size(), digest, &size, EVP_sha256(), nullptr);
  return Hex(digest, size);
}

absl::StatusOr<std::string> Sha256OfFile(const std::string& path) {
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(),
                                                                        &EVP_MD_CTX_free);
  EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr);
  RS_RETURN_IF_ERROR(ReadBlocks(path, [&context](std::string_view block) {
    EVP_DigestUpdate(context.get(), block.data(), block.size());
  }));
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int size = 0;
  EVP_DigestFinal_ex(context.get(), digest, &size);
  return Hex(digest, size);
}

}  // namespace robostress
