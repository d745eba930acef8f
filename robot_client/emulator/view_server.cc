#include "robot_client/emulator/view_server.h"

#include <pthread.h>

#include <algorithm>
#include <utility>

#include "common/status_macros.h"
#include "robot_client/cameras/mapped_frames.h"
#include "robot_client/emulator/view_renderer.h"

namespace robostress::piper {
namespace {

struct View {
  const char* camera;  // of the scene
  const char* ending;  // of the file
};
constexpr View kViews[] = {{"piper_base_view", ".base"}, {"piper_wrist_view", ".wrist"}};

struct FreeData {
  void operator()(mjData* data) const { mj_deleteData(data); }
};

}  // namespace

ViewServer::ViewServer(const ViewServerOptions& options, const Clock* clock)
    : options_(options), clock_(clock) {}

absl::StatusOr<std::unique_ptr<ViewServer>> ViewServer::Create(const ViewServerOptions& options,
                                                               const PiperPlant& plant,
                                                               const Clock* clock) {
  auto server = std::unique_ptr<ViewServer>(new ViewServer(options, clock));
  server->model_.reset(mj_copyModel(nullptr, &plant.model()));
  ViewServer* const self = server.get();
  server->thread_ = std::thread([self] {
    pthread_setname_np(pthread_self(), "views");
    const absl::Status status = self->Serve(&self->stop_);
    {
      absl::MutexLock lock(&self->mu_);
      self->status_ = status;
    }
    self->ready_ = true;
    self->ready_.notify_all();
  });
  // The context belongs to the thread that draws, so whether there is one is known there.
  server->ready_.wait(false);
  absl::MutexLock lock(&server->mu_);
  RS_RETURN_IF_ERROR(server->status_);
  return server;
}

ViewServer::~ViewServer() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

void ViewServer::Show(const mjData& data) {
  absl::MutexLock lock(&mu_);
  qpos_.assign(data.qpos, data.qpos + model_->nq);
  mocap_.assign(data.mocap_pos, data.mocap_pos + 3 * model_->nmocap);
  stamp_ns_ = clock_->now_ns();
}

absl::Status ViewServer::Serve(const std::atomic<bool>* stop) {
  RS_ASSIGN_OR_RETURN(
      const std::unique_ptr<ViewRenderer> renderer,
      ViewRenderer::Create(*model_, options_.width, options_.height, options_.shadows));
  std::vector<std::unique_ptr<MappedFrameWriter>> writers;
  for (const View& view : kViews) {
    RS_ASSIGN_OR_RETURN(
        writers.emplace_back(),
        MappedFrameWriter::Create(options_.prefix + view.ending, options_.width, options_.height));
  }
  const std::unique_ptr<mjData, FreeData> data(mj_makeData(model_.get()));
  ready_ = true;
  ready_.notify_all();
  MonotonicClock pace;
  const auto period = static_cast<int64_t>(1e9 / options_.rate_hz);
  for (int64_t due = pace.now_ns(); !*stop; due = std::max(due + period, pace.now_ns())) {
    pace.SleepUntil(due);
    int64_t stamp = 0;
    {
      absl::MutexLock lock(&mu_);
      if (qpos_.empty()) continue;
      std::copy(qpos_.begin(), qpos_.end(), data->qpos);
      std::copy(mocap_.begin(), mocap_.end(), data->mocap_pos);
      stamp = stamp_ns_;
    }
    mj_kinematics(model_.get(), data.get());
    mj_camlight(model_.get(), data.get());
    for (size_t i = 0; i < writers.size(); ++i) {
      RS_ASSIGN_OR_RETURN(const Image image, renderer->Render(*data, kViews[i].camera));
      RS_RETURN_IF_ERROR(writers[i]->Write(image, stamp));
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress::piper
