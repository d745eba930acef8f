#include "robot_client/cameras_command.h"

#include <csignal>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/clock.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/cameras/preview_server.h"
#include "robot_client/cameras/v4l2_devices.h"
#include "robot_client/client_config.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robot_client cameras
  robot_client cameras --preview 127.0.0.1:8090 --camera wrist=v4l2:/dev/v4l/by-id/NAME \
    --camera base=v4l2:/dev/video4@1280x720
)";

struct CommandLine {
  std::string preview;
  std::vector<std::string> cameras;
  bool anywhere = false;
  double seconds = 0;
};

absl::Status NoCamera() {
  return absl::NotFoundError(
      "no camera: there is no /dev/video*. Plug one in; `lsusb` shows whether the machine sees it. "
      "A kernel without V4L2 (`modprobe uvcvideo` fails), as in most containers and virtual "
      "machines, has none: files:DIR, mapped:FILE and synthetic work everywhere");
}

absl::Status List() {
  const std::vector<V4l2Device> devices = ListV4l2Devices(*MakeV4l2System());
  if (devices.empty()) return NoCamera();
  std::printf("%s", DescribeV4l2Devices(devices).c_str());
  return absl::OkStatus();
}

// Without --camera: every colour camera of this machine.
std::vector<std::string> AllCameras() {
  std::vector<std::string> cameras;
  for (const V4l2Device& device : ListV4l2Devices(*MakeV4l2System())) {
    if (!device.usable()) continue;
    cameras.push_back(absl::StrCat(device.node.substr(device.node.rfind('/') + 1),
                                   "=v4l2:", device.by_id.empty() ? device.node : device.by_id[0]));
  }
  return cameras;
}

absl::Status Preview(const CommandLine& line) {
  MonotonicClock clock;
  const std::vector<std::string> texts = line.cameras.empty() ? AllCameras() : line.cameras;
  if (texts.empty()) return NoCamera();
  std::vector<std::unique_ptr<FrameSource>> cameras;
  std::vector<FrameSource*> sources;
  for (const std::string& text : texts) {
    RS_ASSIGN_OR_RETURN(std::unique_ptr<FrameSource> camera, MakeCamera(text, &clock));
    RS_RETURN_IF_ERROR(camera->Start());
    sources.push_back(camera.get());
    cameras.push_back(std::move(camera));
  }
  // Before the server's thread, which inherits the mask: the signal is waited for here alone.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<PreviewServer> server,
                      PreviewServer::Start({line.preview, line.anywhere}, sources, &clock));
  std::printf("%d cameras on http://%s:%d/ ; Ctrl-C ends\n", static_cast<int>(sources.size()),
              line.preview.substr(0, line.preview.rfind(':')).c_str(), server->port());
  std::fflush(stdout);
  const timespec wait{static_cast<time_t>(line.seconds > 0 ? line.seconds : 1e8), 0};
  sigtimedwait(&signals, nullptr, &wait);
  return absl::OkStatus();
}

}  // namespace

int CamerasMain(int argc, char** argv) {
  cli::App app("Lists the cameras of this machine, or shows them in a browser with their ages.",
               "robot_client cameras");
  app.footer(kExamples);
  CommandLine line;
  app.add_option("--preview", line.preview, "ADDRESS:PORT of a page with the live pictures");
  app.add_option("--camera", line.cameras,
                 "NAME=SOURCE as for a run, repeatable; default: every colour camera found")
      ->allow_extra_args(false);
  app.add_flag("--anywhere", line.anywhere,
               "let --preview listen on an address that other machines reach");
  app.add_option("--seconds", line.seconds, "end the preview by itself")
      ->check(cli::Range(1, 1000000));
  return RunMain(
      app, argc, argv,
      [&] {
        if (line.preview.empty() && !line.cameras.empty()) {
          return absl::InvalidArgumentError(
              "--camera is for a preview; add --preview 127.0.0.1:8090, or leave it out for the "
              "list");
        }
        return line.preview.empty() ? List() : Preview(line);
      },
      [](const absl::Status&) { return kWrongCommand; });
}

}  // namespace robostress
