#include "server/inference/request_queue.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/rollout/refusal.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

class RequestQueueTest : public ::testing::Test {
 protected:
  RequestQueueTest() { options_.capacity = 4; }

  // A request whose session is its name.
  RequestQueue::Request Make(uint64_t session, Priority priority = Priority::kSimulation) {
    auto request = std::make_shared<QueuedRequest>();
    request->session = session;
    request->priority = priority;
    request->arrival = now_;
    return request;
  }
  RequestQueue::Refused Push(RequestQueue& queue, RequestQueue::Request request) {
    return queue.Push(std::move(request), absl::Milliseconds(70));
  }
  std::vector<uint64_t> Pop(RequestQueue& queue, int most,
                            absl::Duration compute_time = absl::ZeroDuration()) {
    std::vector<uint64_t> sessions;
    for (const auto& request : queue.PopBatch(now_, most, compute_time, expired_))
      sessions.push_back(request->session);
    return sessions;
  }

  RequestQueueOptions options_;
  MonotonicTime now_ = MonotonicTime() + std::chrono::hours(1);
  RequestQueue::Refused expired_;
};

TEST_F(RequestQueueTest, RobotsGoBeforeSimulationsAndEachClassInOrderOfArrival) {
  RequestQueue queue(options_);
  for (const uint64_t session : {1, 2}) EXPECT_THAT(Push(queue, Make(session)), IsEmpty());
  for (const uint64_t session : {3, 4})
    EXPECT_THAT(Push(queue, Make(session, Priority::kRobot)), IsEmpty());
  EXPECT_THAT(Pop(queue, 3), ElementsAre(3, 4, 1));
  EXPECT_THAT(Pop(queue, 3), ElementsAre(2));
}

TEST_F(RequestQueueTest, TheEarlierDeadlineGoesFirst) {
  RequestQueue queue(options_);
  const auto late = Make(1, Priority::kRobot), soon = Make(2, Priority::kRobot);
  late->deadline = now_ + std::chrono::milliseconds(200);
  soon->deadline = now_ + std::chrono::milliseconds(100);
  Push(queue, late);
  Push(queue, soon);
  Push(queue, Make(3, Priority::kRobot));
  EXPECT_THAT(Pop(queue, 3), ElementsAre(2, 1, 3));
}

TEST_F(RequestQueueTest, ASimulationThatWaitsTooLongGoesLikeARobot) {
  RequestQueue queue(options_);
  Push(queue, Make(1));
  now_ += std::chrono::seconds(3);
  Push(queue, Make(2, Priority::kRobot));
  EXPECT_THAT(Pop(queue, 1), ElementsAre(1));
}

TEST_F(RequestQueueTest, WhatCannotBeDoneByItsDeadlineIsRefusedAndNotComputed) {
  RequestQueue queue(options_);
  const auto request = Make(1);
  request->deadline = now_ + std::chrono::milliseconds(10);
  Push(queue, request);
  Push(queue, Make(2));
  EXPECT_THAT(Pop(queue, 2, absl::Milliseconds(11)), ElementsAre(2));
  ASSERT_EQ(expired_.size(), 1u);
  EXPECT_EQ(expired_[0].first, request);
  EXPECT_TRUE(absl::IsDeadlineExceeded(expired_[0].second)) << expired_[0].second;
}

TEST_F(RequestQueueTest, AnEstimateThatRefusesEverythingIsTriedWithTheMostTimeLeft) {
  RequestQueue queue(options_);
  const auto passed = Make(1), soon = Make(2), later = Make(3);
  passed->deadline = now_ - std::chrono::milliseconds(1);
  soon->deadline = now_ + std::chrono::milliseconds(10);
  later->deadline = now_ + std::chrono::milliseconds(20);
  for (const auto& request : {passed, soon, later}) Push(queue, request);
  EXPECT_THAT(Pop(queue, 3, absl::Seconds(3)), ElementsAre(3));
  EXPECT_EQ(expired_.size(), 2u);
  Push(queue, passed);
  EXPECT_THAT(Pop(queue, 3, absl::Seconds(3)), IsEmpty()) << "its deadline is over";
}

TEST_F(RequestQueueTest, ANewerObservationReplacesTheWaitingOneOfItsSessionOnly) {
  RequestQueue queue(options_);
  const auto old = Make(1), other = Make(2), lockstep = Make(3), fresh = Make(1);
  old->replaceable = other->replaceable = fresh->replaceable = true;
  Push(queue, old);
  Push(queue, other);
  Push(queue, lockstep);
  const auto refused = Push(queue, fresh);
  ASSERT_EQ(refused.size(), 1u);
  EXPECT_EQ(refused[0].first, old);
  EXPECT_TRUE(absl::IsAborted(refused[0].second));
  EXPECT_THAT(Push(queue, Make(3)), IsEmpty());  // lockstep: both are answered
  EXPECT_THAT(Pop(queue, 4), ElementsAre(2, 3, 1, 3));
}

TEST_F(RequestQueueTest, AFullQueueRefusesAndSaysWhenToComeBack) {
  RequestQueue queue(options_);
  for (uint64_t session = 1; session <= 4; ++session) Push(queue, Make(session));
  const auto refused = Push(queue, Make(5));
  ASSERT_EQ(refused.size(), 1u);
  EXPECT_EQ(refused[0].first->session, 5u);
  EXPECT_TRUE(absl::IsResourceExhausted(refused[0].second));
  EXPECT_EQ(RetryAfter(refused[0].second), absl::Milliseconds(70));
  EXPECT_EQ(queue.size(), 4);
}

TEST_F(RequestQueueTest, InAFullQueueARobotTakesTheLastSimulationsPlaceButNoRobots) {
  RequestQueue queue(options_);
  Push(queue, Make(1));
  Push(queue, Make(2));
  Push(queue, Make(3, Priority::kRobot));
  Push(queue, Make(4, Priority::kRobot));
  for (const uint64_t displaced : {2, 1}) {
    const auto refused = Push(queue, Make(5, Priority::kRobot));
    ASSERT_EQ(refused.size(), 1u);
    EXPECT_EQ(refused[0].first->session, displaced);
    EXPECT_GT(RetryAfter(refused[0].second), absl::ZeroDuration());
  }
  const auto refused = Push(queue, Make(6, Priority::kRobot));
  ASSERT_EQ(refused.size(), 1u);
  EXPECT_EQ(refused[0].first->session, 6u);
}

TEST_F(RequestQueueTest, ABatchIsOfOnePolicyAndWhatMustBeAloneIsAlone) {
  RequestQueue queue(options_);
  const int a = 0, b = 0;
  for (const uint64_t session : {1, 2, 3, 4}) {
    const auto request = Make(session);
    request->group = session == 2 ? &b : &a;
    request->alone = session == 3;
    Push(queue, request);
  }
  EXPECT_THAT(Pop(queue, 4), ElementsAre(1, 4));
  EXPECT_THAT(Pop(queue, 4), ElementsAre(2));
  EXPECT_THAT(Pop(queue, 4), ElementsAre(3));
}

TEST_F(RequestQueueTest, ForgetsWhatIsRemoved) {
  RequestQueue queue(options_);
  const auto request = Make(1);
  Push(queue, request);
  Push(queue, Make(2));
  Push(queue, Make(2));
  EXPECT_TRUE(queue.Remove(request.get()));
  EXPECT_FALSE(queue.Remove(request.get()));
  EXPECT_EQ(queue.RemoveSession(2).size(), 2u);
  EXPECT_EQ(queue.size(), 0);
}

TEST(RetryAfter, IsZeroForEveryOtherStatus) {
  EXPECT_EQ(RetryAfter(absl::OkStatus()), absl::ZeroDuration());
  EXPECT_EQ(RetryAfter(absl::ResourceExhaustedError("disk")), absl::ZeroDuration());
}

}  // namespace
}  // namespace robostress
