#include "robot_client/cameras/preview_server.h"

#include <pthread.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <deque>
#include <optional>
#include <thread>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/html_page.h"
#include "nlohmann/json.hpp"
#include "robot_client/cameras/jpeg.h"

namespace robostress {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using asio::ip::tcp;

constexpr std::chrono::milliseconds kLook{10};  // between looks at the cameras
constexpr int64_t kRateWindow_ns = 2'000'000'000;
constexpr int kMostConnections = 32;
constexpr std::chrono::seconds kIdle{30};

constexpr char kBody[] = R"(<h1>Cameras</h1><div id="cameras"></div>
<style>
#cameras { display: flex; flex-wrap: wrap; gap: 1em }
figure { margin: 0 } img { max-width: 100%; min-width: 160px; background: #444 }
.late { color: #b60 } .stale { color: #c00; font-weight: bold }
</style>
<script>
const boxes = [];
function box(i, name) {
  const figure = document.createElement('figure'), img = document.createElement('img');
  const title = document.createElement('strong'), line = document.createElement('div');
  title.textContent = name;
  figure.append(title, document.createElement('br'), img, line);
  document.getElementById('cameras').append(figure);
  boxes[i] = { img, line };
  const next = () => { img.src = `/picture/${i}.jpg?${Date.now()}` };
  img.onload = () => setTimeout(next, 50);
  img.onerror = () => setTimeout(next, 500);
  next();
}
async function look() {
  try {
    const list = await (await fetch('/cameras.json')).json();
    list.forEach((c, i) => {
      if (!boxes[i]) box(i, c.name);
      const line = boxes[i].line, age = c.age_ms;
      line.className = age === null || age > 500 ? 'stale' : age > 150 ? 'late' : '';
      line.textContent = (age === null ? 'no picture yet'
          : `${c.width} x ${c.height}, ${c.rate_hz.toFixed(1)} Hz, ${age.toFixed(0)} ms old`) +
          (c.dropped ? `, ${c.dropped} damaged` : '') + (c.status ? ` - ${c.status}` : '');
    });
  } catch (e) {
    boxes.forEach(b => { b.line.className = 'stale'; b.line.textContent = 'the preview ended' });
  }
  setTimeout(look, 200);
}
look();
</script></body></html>
)";

struct Watched {
  FrameSource* camera;
  std::shared_ptr<const Frame> newest;
  std::deque<std::pair<int64_t, uint64_t>> arrivals;  // stamp and sequence of the last seconds
  std::pair<uint64_t, std::string> jpeg;              // of a sequence, encoded once

  void Look(int64_t now_ns) {
    std::shared_ptr<const Frame> frame = camera->Latest();
    if (frame != nullptr && (newest == nullptr || frame->sequence != newest->sequence ||
                             frame->stamp_ns != newest->stamp_ns)) {
      if (newest != nullptr && frame->sequence < newest->sequence) arrivals.clear();
      arrivals.emplace_back(frame->stamp_ns, frame->sequence);
      newest = std::move(frame);
    }
    while (!arrivals.empty() && now_ns - arrivals.front().first > kRateWindow_ns)
      arrivals.pop_front();
  }
  double rate_hz() const {
    if (arrivals.size() < 2 || arrivals.back().first <= arrivals.front().first) return 0;
    return static_cast<double>(arrivals.back().second - arrivals.front().second) * 1e9 /
           static_cast<double>(arrivals.back().first - arrivals.front().first);
  }
};

// What is answered, before it becomes HTTP.
struct Reply {
  http::status status = http::status::ok;
  const char* type = "text/plain; charset=utf-8";
  std::string body;
};

// A page of another site whose name was made to resolve to this machine bears that site's name.
bool HostIsAddress(absl::string_view host) {
  if (absl::StartsWith(host, "[")) return true;
  host = host.substr(0, host.find(':'));
  boost::system::error_code error;
  asio::ip::make_address(std::string(host), error);
  return !error || host == "localhost";
}

}  // namespace

class PreviewServer::Impl {
 public:
  Impl(const std::vector<FrameSource*>& cameras, const Clock* clock) : clock_(clock) {
    for (FrameSource* camera : cameras) cameras_.push_back({camera});
  }
  ~Impl() {
    context_.stop();
    if (thread_.joinable()) thread_.join();
  }

  absl::Status Listen(const PreviewOptions& options) {
    const size_t colon = options.listen.rfind(':');
    int port = -1;
    std::string host = options.listen.substr(0, colon);
    if (host == "localhost") host = "127.0.0.1";
    if (absl::StartsWith(host, "[") && absl::EndsWith(host, "]"))
      host = host.substr(1, host.size() - 2);
    boost::system::error_code error;
    const asio::ip::address address = asio::ip::make_address(host, error);
    if (colon == std::string::npos || error ||
        !absl::SimpleAtoi(options.listen.substr(colon + 1), &port) || port < 0 || port > 65535) {
      return absl::InvalidArgumentError(absl::StrCat("--preview is '", options.listen,
                                                     "', must be ADDRESS:PORT, for one "
                                                     "127.0.0.1:8090"));
    }
    if (!address.is_loopback() && !options.anywhere) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--preview ", options.listen, " would show the cameras to every machine that reaches ",
          host, ", without a password; use 127.0.0.1, or add --anywhere where that is meant"));
    }
    const tcp::endpoint endpoint(address, static_cast<uint16_t>(port));
    acceptor_.open(endpoint.protocol(), error);
    if (!error) acceptor_.set_option(tcp::acceptor::reuse_address(true), error);
    if (!error) acceptor_.bind(endpoint, error);
    if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
    if (error) {
      return absl::UnavailableError(absl::StrCat("--preview ", options.listen, ": ",
                                                 error.message(), "; choose another port"));
    }
    return absl::OkStatus();
  }

  void Run() {
    Look();
    Accept();
    thread_ = std::thread([this] {
      pthread_setname_np(pthread_self(), "preview");
      context_.run();
    });
  }
  int port() const { return acceptor_.local_endpoint().port(); }

 private:
  struct Session : std::enable_shared_from_this<Session> {
    Session(Impl* impl, tcp::socket socket) : impl(impl), stream(std::move(socket)) {
      ++impl->connections_;
    }
    ~Session() { --impl->connections_; }
    void Read() {
      parser.emplace();
      parser->body_limit(1024);
      stream.expires_after(kIdle);
      http::async_read(stream, buffer, *parser,
                       [self = shared_from_this()](beast::error_code error, size_t) {
                         if (!error) self->Write();
                       });
    }
    void Write() {
      const auto& request = parser->get();
      Reply reply;
      if (request.method() != http::verb::get) {
        reply = {http::status::method_not_allowed, reply.type, "only GET is answered\n"};
      } else if (!HostIsAddress(
                     {request[http::field::host].data(), request[http::field::host].size()})) {
        reply = {http::status::misdirected_request, reply.type,
                 "ask for this machine by its address or as localhost\n"};
      } else {
        reply = impl->Answer({request.target().data(), request.target().size()});
      }
      response = {};
      response.result(reply.status);
      response.version(request.version());
      response.set(http::field::content_type, reply.type);
      response.set(http::field::cache_control, "no-store");
      response.keep_alive(request.keep_alive());
      response.body() = std::move(reply.body);
      response.prepare_payload();
      http::async_write(stream, response,
                        [self = shared_from_this()](beast::error_code error, size_t) {
                          if (!error && self->response.keep_alive()) self->Read();
                        });
    }
    Impl* const impl;
    beast::tcp_stream stream;
    beast::flat_buffer buffer{8192};
    std::optional<http::request_parser<http::string_body>> parser;
    http::response<http::string_body> response;
  };

  void Accept() {
    acceptor_.async_accept([this](beast::error_code error, tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      // Beyond them the socket is closed unanswered: browsers try again.
      if (!error && connections_ < kMostConnections)
        std::make_shared<Session>(this, std::move(socket))->Read();
      Accept();
    });
  }

  void Look() {
    for (Watched& watched : cameras_) watched.Look(clock_->now_ns());
    timer_.expires_after(kLook);
    timer_.async_wait([this](beast::error_code error) {
      if (!error) Look();
    });
  }

  std::string CamerasJson() const {
    nlohmann::ordered_json list = nlohmann::ordered_json::array();
    const int64_t now = clock_->now_ns();
    for (const Watched& watched : cameras_) {
      nlohmann::ordered_json row = {{"name", watched.camera->name()}};
      const Frame* frame = watched.newest.get();
      for (const char* key : {"width", "height", "sequence", "age_ms"}) row[key] = nullptr;
      if (frame != nullptr) {
        row["width"] = frame->image.width;
        row["height"] = frame->image.height;
        row["sequence"] = frame->sequence;
        row["age_ms"] = static_cast<double>(now - frame->stamp_ns) * 1e-6;
      }
      row["rate_hz"] = watched.rate_hz();
      row["dropped"] = watched.camera->dropped();
      row["status"] = std::string(watched.camera->status().message());
      list.push_back(std::move(row));
    }
    // What is no UTF-8 in a name or message must not end the program.
    return list.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  }

  Reply Picture(absl::string_view text) {
    size_t index = 0;
    if (!absl::SimpleAtoi(text, &index) || index >= cameras_.size())
      return {http::status::not_found, "text/plain; charset=utf-8", "no such camera\n"};
    Watched& watched = cameras_[index];
    if (watched.newest == nullptr) {
      return {http::status::service_unavailable, "text/plain; charset=utf-8",
              absl::StrCat("no picture yet: ", watched.camera->status().message(), "\n")};
    }
    if (watched.jpeg.second.empty() || watched.jpeg.first != watched.newest->sequence) {
      absl::StatusOr<std::string> jpeg = JpegFromRgb(watched.newest->image);
      if (!jpeg.ok()) {
        return {http::status::internal_server_error, "text/plain; charset=utf-8",
                std::string(jpeg.status().message())};
      }
      watched.jpeg = {watched.newest->sequence, *std::move(jpeg)};
    }
    return {http::status::ok, "image/jpeg", watched.jpeg.second};
  }

  Reply Answer(absl::string_view target) {
    target = target.substr(0, target.find('?'));
    if (target == "/")
      return {http::status::ok, "text/html; charset=utf-8", PageHead("Cameras") + kBody};
    if (target == "/cameras.json") return {http::status::ok, "application/json", CamerasJson()};
    if (absl::ConsumePrefix(&target, "/picture/") && absl::ConsumeSuffix(&target, ".jpg"))
      return Picture(target);
    return {http::status::not_found, "text/plain; charset=utf-8", "there is / and nothing else\n"};
  }

  const Clock* const clock_;
  std::vector<Watched> cameras_;
  int connections_ = 0;
  asio::io_context context_{1};
  tcp::acceptor acceptor_{context_};
  asio::steady_timer timer_{context_};
  std::thread thread_;
};

PreviewServer::PreviewServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PreviewServer::~PreviewServer() = default;
int PreviewServer::port() const { return impl_->port(); }

absl::StatusOr<std::unique_ptr<PreviewServer>> PreviewServer::Start(
    const PreviewOptions& options, const std::vector<FrameSource*>& cameras, const Clock* clock) {
  auto impl = std::make_unique<Impl>(cameras, clock);
  const absl::Status listening = impl->Listen(options);
  if (!listening.ok()) return listening;
  impl->Run();
  return std::unique_ptr<PreviewServer>(new PreviewServer(std::move(impl)));
}

}  // namespace robostress
