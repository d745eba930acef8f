#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace robostress {

// Everything that `robostress serve` can be told. The struct is the schema of the configuration
// file and of the command line: key `max_sessions` is the flag --max-sessions, so that neither has
// what the other lacks. 0 threads: one per core.
struct ServeOptions {
  std::string policy = "nano";
  std::vector<std::string> policy_options;
  std::string listen = "127.0.0.1:0", port_file;
  int threads = 0, max_batch = 8;
  double batch_window_ms = 0;
  int queue_capacity = 256, cores = 0, update_nice = 5;
  double update_share = 0.1;
  int max_sessions = 64;
  int max_rank = 16, max_update_batch = 8, min_update_interval = 4, max_buffer_chunks = 128;
  int64_t prefix_budget_mib = 512;
  bool warm_up = true;
  std::string state_dir;
  double session_expiry = 0;
  uint64_t snapshot_mib = 64, snapshot_records = 1024;
  bool sync_predictions = false, guard = false;
  double guard_ratio = 1, guard_distance = 0;
  std::string websocket_listen, websocket_method = "base";
  std::vector<std::string> websocket_cameras;
  std::string websocket_prompt;
  int64_t websocket_max_mib = 0;
  bool websocket_resize = false;
  int max_view_side = 0;
  int max_connections = 256, connections_per_client = 0;
  std::vector<std::string> allowed_hosts;
  std::string http_listen, admin_listen, ports_file;
  std::string tls_certificate, tls_key, tls_client_ca, tokens;
  double reload_seconds = 10;
  std::string health_listen;
  std::string log_format = "text", log_level = "info";
  double grace = 10;
  // gRPC calls.
  int calls_per_client = 0;
  double stream_idle = 900;
  // Limits that few need to change.
  int max_stored_sessions = 4096;
  double abandoned_after = 900, lockstep_timeout = 120, starvation_limit = 2;
  int max_message_mib = 256, kept_traces = 256;
  double request_timeout = 30, idle_timeout = 60;
  int health_connections = 32;

  template <class V>
  void Visit(V& v) {
    v.Field("policy", policy,
            "nano, nano:random, a weights file (.safetensors), or the folder of a pi0 or pi0.5 "
            "checkpoint");
    v.Field("policy_options", policy_options,
            "KEY=VALUE ... over those of robostress_policy.yaml; `robostress policy inspect "
            "--help` lists them");
    v.Field("listen", listen, "gRPC on HOST:PORT; port 0 takes a free one");
    v.Field("port_file", port_file, "write the bound gRPC port to this file");
    v.Field("threads", threads,
            "batches of predictions computed at once, and as many update threads; 0: one per core");
    v.Field("max_batch", max_batch,
            "predictions computed in one pass, each with its own adapter; 1: none is batched");
    v.Field("batch_window_ms", batch_window_ms,
            "how long a batch that is not full waits for more; 0: it takes what has come");
    v.Field("queue_capacity", queue_capacity,
            "predictions that may wait; more are refused and told when to come back");
    v.Field("update_share", update_share,
            "of one core's time that updates keep, all together, while predictions need the cores, "
            "above 0 to 1 (updates never yield)");
    v.Field("cores", cores,
            "that predictions and updates share; updates yield beyond it. 1: whenever a "
            "prediction is under way; 0: all of this machine");
    v.Field("update_nice", update_nice,
            "added to the nice value of the threads on which asynchronous sessions learn");
    v.Field("max_sessions", max_sessions, "sessions open at once");
    v.Field("max_rank", max_rank, "largest LoRA rank that a session may open with");
    v.Field("max_update_batch", max_update_batch, "most chunks of one update, likewise");
    v.Field("min_update_interval", min_update_interval,
            "fewest chunks between two updates, likewise");
    v.Field("max_buffer_chunks", max_buffer_chunks, "longest feedback buffer, likewise");
    v.Field("prefix_budget_mib", prefix_budget_mib,
            "memory for the prefixes that adapters learn from, all sessions together; what exceeds "
            "it is dropped and encoded again when an update needs it");
    v.Field("warm_up", warm_up, "predict once before health says SERVING");
    v.Field("state_dir", state_dir,
            "folder where sessions are kept: feedback is acknowledged when it is on this disk, and "
            "sessions are resumed after a restart; empty: they live in memory");
    v.Field("session_expiry", session_expiry,
            "seconds after which an unused session is closed, on disk too; 0: never");
    v.Field("snapshot_mib", snapshot_mib,
            "journal of a session after which its state is written anew");
    v.Field("snapshot_records", snapshot_records, "the same in records");
    v.Field("sync_predictions", sync_predictions,
            "predictions are on the disk before they are answered: none is lost with the power");
    v.Field("guard", guard,
            "refuse updates whose candidate is worse on chunks that they did not sample; for "
            "sessions that ask for no guard of their own");
    v.Field("guard_ratio", guard_ratio, "largest loss of a candidate over the published adapter's");
    v.Field("guard_distance", guard_distance,
            "largest ||phi - phi_0|| of a candidate; 0: no bound");
    v.Field("websocket_listen", websocket_listen,
            "openpi's clients on HOST:PORT (theirs expect 8000); empty: not served");
    v.Field("websocket_method", websocket_method,
            "method of openpi's clients that name none: base adapts nothing");
    v.Field("websocket_cameras", websocket_cameras,
            "the clients' key of each of the policy's cameras, in its order; empty: those of "
            "LIBERO, DROID, ALOHA or the cameras' names");
    v.Field("websocket_prompt", websocket_prompt, "of clients that send none");
    v.Field("websocket_max_mib", websocket_max_mib,
            "largest WebSocket message; 0: what the largest observation and report of the policy "
            "need");
    v.Field("websocket_resize", websocket_resize,
            "resize views of other sizes than the policy's, with padding as openpi's clients do; "
            "without it only for clients that ask (session: {resize: true})");
    v.Field("max_view_side", max_view_side,
            "[px] greatest side of a view; 0: what the policy takes, 1280 where views are resized "
            "(256 where only a client asks for it)");
    v.Field("max_connections", max_connections,
            "WebSocket and, apart from them, HTTP connections; 8 more answer only /healthz and "
            "/readyz");
    v.Field("connections_per_client", connections_per_client,
            "of them, by address and then by token or certificate; 0: half of max_connections");
    v.Field("allowed_hosts", allowed_hosts,
            "NAME ... by which browsers may ask for pages, besides addresses, localhost and the "
            "name listened on (DNS rebinding)");
    v.Field("http_listen", http_listen,
            "live page, /metrics, /traces, /healthz, /readyz on HOST:PORT; empty: not served");
    v.Field("admin_listen", admin_listen, "AdminService on HOST:PORT; empty: not served");
    v.Field("ports_file", ports_file,
            "write every bound port to this file: grpc, websocket, http, admin, health");
    v.Field("tls_certificate", tls_certificate, "PEM file; with it every port speaks TLS only");
    v.Field("tls_key", tls_key, "PEM file, readable by this user only");
    v.Field("tls_client_ca", tls_client_ca,
            "PEM file; clients must show a certificate that it signed (mTLS)");
    v.Field("tokens", tokens,
            "YAML file of SHA-256 of tokens with scopes (server/operations/README.md); empty: "
            "everybody "
            "may do everything");
    v.Field("reload_seconds", reload_seconds,
            "certificates and tokens are read again so often, and at SIGHUP; 0: at SIGHUP alone");
    v.Field("health_listen", health_listen,
            "/healthz and /readyz alone on HOST:PORT, for probes: no TLS, no token, connections of "
            "their own; empty: not served");
    v.Field("log_format", log_format, "text, or json: one object per line");
    v.Field("log_level", log_level, "debug (every prediction), info, warn, error, off");
    v.Field("calls_per_client", calls_per_client,
            "gRPC calls and streams that one token, certificate or address may have open; 0: 4 for "
            "each of --max-sessions and 64 more");
    v.Field("stream_idle", stream_idle,
            "seconds after which a gRPC stream is ended on which nothing comes or is taken");
    v.Field("grace", grace, "seconds to answer what is under way when stopped");

    v.Field("max_stored_sessions", max_stored_sessions,
            "sessions in memory and on disk together; one more is refused");
    v.Field("abandoned_after", abandoned_after,
            "seconds after which an unused session makes room for a new one when --max-sessions "
            "are open");
    v.Field("lockstep_timeout", lockstep_timeout,
            "seconds that a lockstep prediction waits for feedback that was announced");
    v.Field("starvation_limit", starvation_limit,
            "seconds after which a waiting simulation goes like a real arm");
    v.Field("max_message_mib", max_message_mib, "largest gRPC message, in and out");
    v.Field("kept_traces", kept_traces, "predictions whose spans /traces shows");
    v.Field("request_timeout", request_timeout,
            "seconds for a TLS or WebSocket handshake, an HTTP request and its answer");
    v.Field("idle_timeout", idle_timeout,
            "seconds after which a WebSocket is cut whose peer neither sends, nor answers a ping, "
            "nor reads; it is pinged at half of them");
    v.Field("health_connections", health_connections, "connections to --health-listen");
  }
};

}  // namespace robostress
