#include "absl/strings/str_cat.h"
#include "common/random.h"
#include "common/status_macros.h"
#include "python/library/boundary.h"
#include "python/library/robostress.h"

struct robostress_stream {
  explicit robostress_stream(const robostress::StreamKey& of) : key(of), stream(of) {}
  void Rekey(const robostress::StreamKey& to) { *this = robostress_stream(to); }

  robostress::StreamKey key;
  robostress::RandomStream stream;
};

extern "C" {

robostress_code robostress_stream_new(const char* purpose, robostress_stream** created, char* error,
                                      size_t error_size) {
  return robostress::AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(robostress::CheckHandle("purpose", purpose));
    RS_RETURN_IF_ERROR(robostress::CheckHandle("created", created));
    *created = new robostress_stream(robostress::StreamKey(purpose));
    return absl::OkStatus();
  });
}

void robostress_stream_free(robostress_stream* stream) { delete stream; }

void robostress_stream_add_text(robostress_stream* stream, const char* part) {
  if (stream != nullptr && part != nullptr) stream->Rekey(stream->key.With(part));
}

void robostress_stream_add_number(robostress_stream* stream, int64_t part) {
  if (stream != nullptr) stream->Rekey(stream->key.With(part));
}

void robostress_stream_uniform(robostress_stream* stream, double* values, size_t count) {
  if (stream == nullptr || values == nullptr) return;
  for (size_t i = 0; i < count; ++i) values[i] = stream->stream.Uniform();
}

void robostress_stream_normal(robostress_stream* stream, double* values, size_t count) {
  if (stream == nullptr || values == nullptr) return;
  for (size_t i = 0; i < count; ++i) values[i] = stream->stream.Normal();
}

void robostress_stream_integers(robostress_stream* stream, int n, int* values, size_t count) {
  if (stream == nullptr || values == nullptr) return;
  for (size_t i = 0; i < count; ++i) values[i] = n < 1 ? 0 : stream->stream.UniformInt(n);
}

}  // extern "C"
