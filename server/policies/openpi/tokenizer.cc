#include "server/policies/openpi/tokenizer.h"

#include <signal.h>
#include <spawn.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

extern char** environ;

namespace robostress::openpi {
namespace {

constexpr timeval kAnswerTimeout = {60, 0};  // a cold disk and a busy machine included
constexpr size_t kMaxLine = size_t{1} << 22;

constexpr char kHowToGet[] =
    "Fetch paligemma_tokenizer.model of gs://big_vision (4 MB; "
    "https://storage.googleapis.com/big_vision/paligemma_tokenizer.model) or tokenizer.model of "
    "google/paligemma-3b-pt-224 on Hugging Face, put it beside the checkpoint, or name it with "
    "tokenizer=FILE or ROBOSTRESS_TOKENIZER";

// What one line of the process says, or its error.
absl::StatusOr<nlohmann::json> ParseAnswer(const std::string& path, const std::string& line) {
  nlohmann::json answer = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (answer.is_object() && answer.contains("error") && answer["error"].is_string()) {
    return absl::InvalidArgumentError(
        absl::StrCat("tokenizer ", path, ": ", answer["error"].get<std::string>()));
  }
  if (!answer.is_object() && !answer.is_array()) {
    return absl::InternalError(
        absl::StrCat("tokenizer ", path, ": unexpected answer '", line.substr(0, 80), "'"));
  }
  return answer;
}

// -1 where it is no integer.
int64_t IntegerOf(const nlohmann::json& object, const char* key) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  return found != object.end() && found->is_number_integer() ? found->get<int64_t>() : -1;
}

absl::Status CheckFile(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) {
    return absl::NotFoundError(absl::StrCat("tokenizer ", path, " is no file. ", kHowToGet));
  }
  const uintmax_t bytes = std::filesystem::file_size(path, error);
  if (error || bytes == 0 || bytes > Tokenizer::kMaxFileBytes) {
    return absl::InvalidArgumentError(absl::StrCat("tokenizer ", path, " has ", bytes,
                                                   " bytes, must have 1..",
                                                   Tokenizer::kMaxFileBytes, ". ", kHowToGet));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<Tokenizer>> Tokenizer::Load(const std::string& path) {
  RS_RETURN_IF_ERROR(CheckFile(path));
  std::unique_ptr<Tokenizer> tokenizer(new Tokenizer(path));
  absl::MutexLock lock(&tokenizer->mu_);
  RS_RETURN_IF_ERROR(tokenizer->Start());
  RS_ASSIGN_OR_RETURN(const std::string line, tokenizer->ReadLine());
  RS_ASSIGN_OR_RETURN(const nlohmann::json hello, ParseAnswer(path, line));
  tokenizer->pieces_ = IntegerOf(hello, "pieces");
  tokenizer->bos_ = IntegerOf(hello, "bos");
  if (tokenizer->bos_ < 0 || tokenizer->bos_ >= tokenizer->pieces_) {
    return absl::InvalidArgumentError(absl::StrCat(
        "tokenizer ", path, " has no piece that begins a text (bos_id is ", tokenizer->bos_, " of ",
        tokenizer->pieces_, " pieces), which prompts need. ", kHowToGet));
  }
  return tokenizer;
}

Tokenizer::~Tokenizer() {
  absl::MutexLock lock(&mu_);
  End();
}

pid_t Tokenizer::process_id() const {
  absl::MutexLock lock(&mu_);
  return pid_;
}

absl::Status Tokenizer::Start() const {
  RS_ASSIGN_OR_RETURN(std::string program, FindProgram("tokenize"));
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
    return absl::InternalError(absl::StrCat("tokenizer: no socket: ", strerror(errno)));
  }
  setsockopt(ends[0], SOL_SOCKET, SO_RCVTIMEO, &kAnswerTimeout, sizeof kAnswerTimeout);
  setsockopt(ends[0], SOL_SOCKET, SO_SNDTIMEO, &kAnswerTimeout, sizeof kAnswerTimeout);

  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[1], STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  // A group of its own, so that Ctrl-C reaches the server only; it ends when the socket closes.
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK);
  sigset_t none;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  std::string model = path_;
  char* const arguments[] = {program.data(), model.data(), nullptr};
  const int error = posix_spawn(&pid_, program.c_str(), &actions, &attributes, arguments, environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[1]);
  socket_ = ends[0];
  if (error == 0) return absl::OkStatus();
  pid_ = -1;
  End();
  return absl::InternalError(absl::StrCat("cannot start ", program, ": ", strerror(error)));
}

void Tokenizer::End() const {
  if (socket_ >= 0) close(socket_);
  socket_ = -1;
  if (pid_ < 0) return;
  kill(pid_, SIGTERM);  // it may be busy with a text; nothing of it is kept
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
  }
  pid_ = -1;
}

absl::StatusOr<std::string> Tokenizer::ReadLine() const {
  std::string line;
  char buffer[4096];
  while (line.empty() || line.back() != '\n') {
    const ssize_t n = recv(socket_, buffer, sizeof buffer, 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0 || line.size() > kMaxLine) {
      const std::string why = n == 0  ? "ended without an answer; its file may be damaged"
                              : n < 0 ? absl::StrCat("does not answer: ", strerror(errno))
                                      : "answers without end";
      End();
      return absl::UnavailableError(
          absl::StrCat("tokenizer ", path_, ": the process that reads it ", why));
    }
    line.append(buffer, static_cast<size_t>(n));
  }
  return line;
}

absl::StatusOr<std::string> Tokenizer::Ask(const std::string& line) const {
  for (size_t sent = 0; sent < line.size();) {
    const ssize_t n = send(socket_, line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;  // the process is gone; ReadLine says so
    sent += static_cast<size_t>(n);
  }
  return ReadLine();
}

absl::StatusOr<std::vector<int64_t>> Tokenizer::Encode(const std::string& text) const {
  std::string line;
  try {
    line = nlohmann::json(text).dump() + "\n";
  } catch (const nlohmann::json::exception&) {  // the only refusal that dump knows
    return absl::InvalidArgumentError("the instruction is not UTF-8 text");
  }
  absl::MutexLock lock(&mu_);
  absl::StatusOr<std::string> answer = absl::UnavailableError("not running");
  if (pid_ >= 0) answer = Ask(line);
  if (!answer.ok()) {
    RS_RETURN_IF_ERROR(Start());
    RS_RETURN_IF_ERROR(ReadLine().status());  // it introduces itself
    answer = Ask(line);
  }
  RS_RETURN_IF_ERROR(answer.status());
  RS_ASSIGN_OR_RETURN(const nlohmann::json json, ParseAnswer(path_, *answer));
  std::vector<int64_t> ids;
  for (const nlohmann::json& id : json) {
    if (!id.is_number_integer() || id < 0 || id >= pieces_) {
      return absl::InternalError(
          absl::StrCat("tokenizer ", path_, ": id ", id.dump(), " is outside 0..", pieces_ - 1));
    }
    ids.push_back(id.get<int64_t>());
  }
  return ids;
}

absl::Status CheckPieces(const Tokenizer& tokenizer, int64_t rows) {
  if (tokenizer.pieces() <= rows) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "tokenizer ", tokenizer.path(), " has ", tokenizer.pieces(), " pieces, the embedding only ",
      rows, " rows; give the tokenizer that the checkpoint was trained with"));
}

absl::StatusOr<std::string> FindTokenizer(const std::string& option, const std::string& folder) {
  std::vector<std::string> places;
  if (!option.empty()) {
    places = {option};
  } else if (const char* variable = std::getenv("ROBOSTRESS_TOKENIZER");
             variable != nullptr && *variable != '\0') {
    places = {variable};
  } else {
    for (const char* name : {"paligemma_tokenizer.model", "tokenizer.model"})
      places.push_back((std::filesystem::path(folder) / name).string());
  }
  std::string looked;
  for (const std::string& place : places) {
    std::error_code error;
    if (std::filesystem::is_regular_file(place, error)) return place;
    absl::StrAppend(&looked, looked.empty() ? "" : ", ", place);
  }
  return absl::NotFoundError(absl::StrCat(
      "no SentencePiece tokenizer; looked for ", looked,
      !option.empty()     ? " (option tokenizer)"
      : places.size() < 2 ? " (ROBOSTRESS_TOKENIZER)"
                          : " (neither option tokenizer nor ROBOSTRESS_TOKENIZER is set)",
      ". ", kHowToGet));
}

}  // namespace robostress::openpi
