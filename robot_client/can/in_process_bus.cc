#include "robot_client/can/in_process_bus.h"

#include <algorithm>

namespace robostress {

class InProcessBus::Node : public CanBus {
 public:
  explicit Node(std::shared_ptr<Wire> wire) : wire_(std::move(wire)) {}
  ~Node() override {
    absl::MutexLock lock(&wire_->mutex);
    std::erase(wire_->inboxes, inbox_.get());
  }

  absl::Status Open() override {
    if (health_.state == CanState::kActive) return absl::OkStatus();
    absl::MutexLock lock(&wire_->mutex);
    wire_->inboxes.push_back(inbox_.get());
    health_.state = CanState::kActive;
    return absl::OkStatus();
  }

  absl::Status Send(const CanFrame& frame) override {
    if (health_.state != CanState::kActive) return absl::UnavailableError("");
    absl::MutexLock lock(&wire_->mutex);
    const int64_t now_ns = wire_->clock.now_ns();
    for (Inbox* inbox : wire_->inboxes) {
      if (inbox == inbox_.get()) continue;
      if (inbox->count == kQueue) {
        inbox->first = (inbox->first + 1) % kQueue;
        --inbox->count;
        ++inbox->overflows;
      }
      inbox->frames[(inbox->first + inbox->count++) % kQueue] = {frame, now_ns};
    }
    ++health_.sent;
    return absl::OkStatus();
  }

  bool Receive(StampedFrame& frame) override {
    absl::MutexLock lock(&wire_->mutex);
    health_.overflows = inbox_->overflows;
    if (inbox_->count == 0) return false;
    frame = inbox_->frames[inbox_->first];
    inbox_->first = (inbox_->first + 1) % kQueue;
    --inbox_->count;
    ++health_.received;
    return true;
  }

  CanHealth health() const override { return health_; }
  std::string description() const override { return wire_->name; }

 private:
  const std::shared_ptr<Wire> wire_;
  const std::unique_ptr<Inbox> inbox_ = std::make_unique<Inbox>();  // guarded by wire_->mutex
  CanHealth health_;
};

std::unique_ptr<CanBus> InProcessBus::Attach() { return std::make_unique<Node>(wire_); }

}  // namespace robostress
