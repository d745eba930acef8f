#pragma once

#include <sys/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/synchronization/mutex.h"

namespace robostress::openpi {

// A SentencePiece model, computed by Debian's libsentencepiece in a process of its own
// (robostress-tokenize). The library holds Protobuf 3.14 and exports it: in one process with the
// 3.21 of gRPC and LibTorch one of the two answers for both, and the program aborts at its start. A
// damaged model that crashes the library ends that process and not the server.
class Tokenizer {
 public:
  static constexpr int64_t kMaxFileBytes = int64_t{64} << 20;  // PaliGemma's has 4 MiB

  // Starts the process and reads the model. The error names the file and what is wrong with it.
  static absl::StatusOr<std::unique_ptr<Tokenizer>> Load(const std::string& path);
  ~Tokenizer();  // ends the process
  Tokenizer(const Tokenizer&) = delete;
  Tokenizer& operator=(const Tokenizer&) = delete;

  const std::string& path() const { return path_; }
  int64_t pieces() const { return pieces_; }  // ids are 0 .. pieces() - 1
  int64_t bos() const { return bos_; }        // begins every prompt
  pid_t process_id() const ABSL_LOCKS_EXCLUDED(mu_);

  // Ids of UTF-8 text, without BOS. Any thread; one text at a time. A process that died is started
  // once more.
  absl::StatusOr<std::vector<int64_t>> Encode(const std::string& text) const
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit Tokenizer(std::string path) : path_(std::move(path)) {}
  absl::Status Start() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void End() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::StatusOr<std::string> Ask(const std::string& line) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::StatusOr<std::string> ReadLine() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const std::string path_;
  int64_t pieces_ = 0, bos_ = 0;
  mutable absl::Mutex mu_;
  mutable pid_t pid_ ABSL_GUARDED_BY(mu_) = -1;
  mutable int socket_ ABSL_GUARDED_BY(mu_) = -1;
};

// OK when every id has one of `rows` embedding rows.
absl::Status CheckPieces(const Tokenizer& tokenizer, int64_t rows);

// The model file of a checkpoint: `option` where it is not empty, else ROBOSTRESS_TOKENIZER, else
// paligemma_tokenizer.model or tokenizer.model in `folder`. NOT_FOUND says where it looked and how
// to get the file.
absl::StatusOr<std::string> FindTokenizer(const std::string& option, const std::string& folder);

}  // namespace robostress::openpi
