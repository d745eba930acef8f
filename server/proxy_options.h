#pragma once

#include <string>
#include <vector>

namespace robostress {

// What `robostress proxy` can be told; key a_b is the flag --a-b.
struct ProxyOptions {
  std::string upstream, robot, method;
  std::vector<std::string> set;
  std::string listen = "127.0.0.1:8001", http_listen = "127.0.0.1:8002";
  bool shadow = false;
  std::string out, ports_file;
  std::string tls_certificate, tls_key, tls_client_ca, tokens;
  int max_clients = 64, max_message_mib = 64;
  std::string log_format = "text", log_level = "info";

  template <class V>
  void Visit(V& v) {
    v.Field("upstream", upstream, "ws://HOST:PORT or wss:// of the policy server");
    v.Field("robot", robot, "robot.yaml: what its actions and its state mean");
    v.Field("listen", listen, "clients on HOST:PORT; port 0 takes a free one");
    v.Field("method", method, "instead of the profile's");
    v.Field("set", set, "KEY=VALUE over the method's options, repeatable");
    v.Field("shadow", shadow, "learn and report; change no answer");
    v.Field("http_listen", http_listen,
            "live page, /state, /metrics, /healthz, /readyz and the switch on HOST:PORT");
    v.Field("out", out, "folder for residuals.csv and logs for calibrate; empty: none is written");
    v.Field("ports_file", ports_file, "write the bound ports to this file: websocket, http");
    v.Field("tls_certificate", tls_certificate, "PEM file; with it clients must speak wss");
    v.Field("tls_key", tls_key, "PEM file, readable by this user only");
    v.Field("tls_client_ca", tls_client_ca,
            "PEM file; clients must show a certificate that it signed");
    v.Field("tokens", tokens,
            "YAML file of tokens (server/operations/README.md) of which clients must show one with "
            "scope predict; empty: a client's key goes on to the policy server");
    v.Field("max_clients", max_clients, "connected at once");
    v.Field("max_message_mib", max_message_mib, "longest message, either way");
    v.Field("log_format", log_format, "text, or json: one object per line");
    v.Field("log_level", log_level, "debug, info, warn, error, off");
  }
};

}  // namespace robostress
