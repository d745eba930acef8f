#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <string>
#include <utility>

#include "server/wire/fair_executor.h"
#include "server/wire/web/web_server.h"

namespace robostress {

// What the connections of a server share. Outlives them.
struct WebServices {
  const WebServerOptions& options;
  const WebServer::Page& page;
  const WebServer::Upgrade& upgrade;
  boost::asio::io_context& io;  // run by one thread, to which all connections belong
  FairExecutor& workers;        // for what may wait
};

// `work()` on a worker of `client`, then `then(what it returned)` on the I/O thread. `then` holds
// what `work` uses. Neither may throw. Of one `few` that is not empty, two are at work at most.
template <class Work, class Then>
void WorkThen(const WebServices& services, const std::string& client, const std::string& few,
              Work work, Then then) {
  services.workers.Post(
      client, few, [&io = services.io, work = std::move(work), then = std::move(then)]() mutable {
        auto result = work();
        // Nothing that `then` holds may end on this thread.
        boost::asio::post(io, [then = std::move(then), result = std::move(result)]() mutable {
          then(std::move(result));
        });
      });
}

}  // namespace robostress
