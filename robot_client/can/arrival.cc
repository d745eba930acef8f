#include "robot_client/can/arrival.h"

#include <algorithm>
#include <cstring>
#include <ctime>

namespace robostress {

Arrival ReadArrival(const msghdr& message, int64_t now_ns) {
  Arrival arrival{now_ns, std::nullopt};
  for (cmsghdr* header = CMSG_FIRSTHDR(&message); header != nullptr;
       header = CMSG_NXTHDR(const_cast<msghdr*>(&message), header)) {
    if (header->cmsg_level != SOL_SOCKET) continue;
    if (header->cmsg_type == SCM_TIMESTAMPNS) {
      timespec stamp, wall;
      std::memcpy(&stamp, CMSG_DATA(header), sizeof stamp);
      clock_gettime(CLOCK_REALTIME, &wall);
      const int64_t age_ns = (static_cast<int64_t>(wall.tv_sec) - stamp.tv_sec) * 1'000'000'000 +
                             (wall.tv_nsec - stamp.tv_nsec);
      arrival.stamp_ns = now_ns - std::clamp<int64_t>(age_ns, 0, kMaxQueueAge_ns);
    } else if (header->cmsg_type == SO_RXQ_OVFL) {
      uint32_t lost = 0;
      std::memcpy(&lost, CMSG_DATA(header), sizeof lost);
      arrival.overflows = lost;
    }
  }
  return arrival;
}

}  // namespace robostress
