// Microseconds for one observation of openpi's LIBERO client: two 224 x 224 views, 8 numbers, a
// prompt (301 kB). Memcpy is what one copy of its pixels costs here.
#include <benchmark/benchmark.h>

#include <cstring>
#include <string>

#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_observation.h"

namespace robostress {
namespace {

Observation Seen() {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  for (const char* camera : {"agentview", "wrist"}) {
    Image image{224, 224, std::vector<uint8_t>(3 * 224 * 224)};
    for (size_t i = 0; i < image.data.size(); ++i) image.data[i] = static_cast<uint8_t>(i * 7 / 3);
    observation.views.push_back({camera, std::move(image)});
  }
  observation.proprioception = Eigen::VectorXf::LinSpaced(8, 0, 1);
  return observation;
}

void Write(benchmark::State& state) {
  const Observation seen = Seen();
  OpenpiDialect dialect = *OpenpiDialectNamed("libero");
  dialect.planes_first = state.range(0) != 0;
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(*WriteOpenpiObservation(seen, dialect));
}
BENCHMARK(Write)->ArgName("planes_first")->Arg(0)->Arg(1)->Unit(benchmark::kMicrosecond);

void Read(benchmark::State& state) {
  const Observation seen = Seen();
  OpenpiDialect dialect = *OpenpiDialectNamed("libero");
  dialect.planes_first = state.range(0) != 0;
  const std::string bytes = *WriteOpenpiObservation(seen, dialect);
  PolicySpec policy;
  policy.cameras = {"agentview", "wrist"};
  policy.image_width = policy.image_height = 224;
  for ([[maybe_unused]] auto _ : state) {
    const OpenpiValue message = *DecodeOpenpi(bytes);
    benchmark::DoNotOptimize(*ReadOpenpiObservation(message, policy, {}, false));
  }
}
BENCHMARK(Read)->ArgName("planes_first")->Arg(0)->Arg(1)->Unit(benchmark::kMicrosecond);

void Memcpy(benchmark::State& state) {
  const std::string from(2 * 3 * 224 * 224, 'x');
  for ([[maybe_unused]] auto _ : state) {
    std::string to = from;
    benchmark::DoNotOptimize(to.data());
  }
}
BENCHMARK(Memcpy)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
