#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

struct PreviewOptions {
  std::string listen = "127.0.0.1:8090";  // ADDRESS:PORT; port 0: any that is free
  bool anywhere = false;  // whether another address than this machine's own may be given
};

// Shows cameras in a browser, with the age, size and rate of every picture:
//
//   /                 the page
//   /cameras.json     a list of {name, width, height, sequence, age_ms, rate_hz, dropped, status};
//                     null where there is no picture
//   /picture/N.jpg    the newest picture of camera N as JPEG; 503 with the reason where there is
//   none
//
// One thread of its own, which alone asks the cameras: do not show cameras that a policy link uses.
class PreviewServer {
 public:
  // The cameras are started and outlive the server. An error names the address and what to do.
  static absl::StatusOr<std::unique_ptr<PreviewServer>> Start(
      const PreviewOptions& options, const std::vector<FrameSource*>& cameras, const Clock* clock);
  ~PreviewServer();  // cuts what is under way and joins
  int port() const;

 private:
  class Impl;
  explicit PreviewServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
