#include "common/lerobot/feature_statistics.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/statistics.h"

namespace robostress {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::pair<const char*, double> kQuantiles[] = {
    {"q01", 0.01}, {"q10", 0.1}, {"q50", 0.5}, {"q90", 0.9}, {"q99", 0.99}};

// Of one dimension, appended to the lists of `out`.
void AppendTo(Json* out, const char* key, double value) { (*out)[key].push_back(value); }

void Append(std::vector<double> values, Json* out) {
  std::sort(values.begin(), values.end());
  double sum = 0, squares = 0;
  for (const double v : values) sum += v;
  const double mean = sum / static_cast<double>(values.size());
  for (const double v : values) squares += (v - mean) * (v - mean);
  AppendTo(out, "min", values.front());
  AppendTo(out, "max", values.back());
  AppendTo(out, "mean", mean);
  AppendTo(out, "std", std::sqrt(squares / static_cast<double>(values.size())));
  for (const auto& [name, q] : kQuantiles) AppendTo(out, name, Quantile(values, q));
}

// The numbers of two nested lists of one shape, combined.
template <class F>
Json Map2(const Json& a, const Json& b, F f) {
  if (!a.is_array()) return f(a.get<double>(), b.get<double>());
  Json out = Json::array();
  for (size_t i = 0; i < a.size(); ++i) out.push_back(Map2(a.at(i), b.at(i), f));
  return out;
}

}  // namespace

Json VectorStatistics(absl::Span<const double> rows, size_t width) {
  Json out = Json::object();
  const size_t count = rows.size() / width;
  for (size_t column = 0; column < width; ++column) {
    std::vector<double> values(count);
    for (size_t row = 0; row < count; ++row) values[row] = rows[row * width + column];
    Append(std::move(values), &out);
  }
  out["count"] = {count};
  return out;
}

Json PictureStatistics(const std::vector<Image>& pictures) {
  Json out = Json::object();
  for (int channel = 0; channel < 3; ++channel) {
    std::array<uint64_t, 256> histogram{};
    uint64_t total = 0;
    for (const Image& picture : pictures) {
      for (size_t i = static_cast<size_t>(channel); i < picture.data.size(); i += 3)
        ++histogram[picture.data[i]];
      total += picture.data.size() / 3;
    }
    double sum = 0, squares = 0;
    int lowest = 255, highest = 0;
    for (int v = 0; v < 256; ++v) {
      if (histogram[v] == 0) continue;
      lowest = std::min(lowest, v);
      highest = std::max(highest, v);
      sum += static_cast<double>(histogram[v]) * v;
      squares += static_cast<double>(histogram[v]) * v * v;
    }
    const double n = static_cast<double>(total), mean = sum / n;
    const auto put = [&out](const char* key, double value) {
      out[key].push_back(Json::array({Json::array({value / 255})}));
    };
    put("min", lowest);
    put("max", highest);
    put("mean", mean);
    put("std", std::sqrt(std::max(0.0, squares / n - mean * mean)));
    for (const auto& [name, q] : kQuantiles) {
      uint64_t below = 0;
      int v = 0;
      while (v < 255 && static_cast<double>(below += histogram[v]) < q * n) ++v;
      put(name, v);
    }
  }
  out["count"] = {pictures.size()};
  return out;
}

Json JoinStatistics(const Json& a, const Json& b) {
  const double na = a.at("count").at(0), nb = b.at("count").at(0), n = na + nb;
  const auto average = [&](double x, double y) { return (na * x + nb * y) / n; };
  Json out = Json::object();
  out["min"] = Map2(a.at("min"), b.at("min"), [](double x, double y) { return std::min(x, y); });
  out["max"] = Map2(a.at("max"), b.at("max"), [](double x, double y) { return std::max(x, y); });
  out["mean"] = Map2(a.at("mean"), b.at("mean"), average);
  const auto square = [](const Json& list, const Json& mean) {
    return Map2(list, mean, [](double s, double m) { return s * s + m * m; });
  };
  const Json second =
      Map2(square(a.at("std"), a.at("mean")), square(b.at("std"), b.at("mean")), average);
  out["std"] = Map2(second, out["mean"],
                    [](double s, double m) { return std::sqrt(std::max(0.0, s - m * m)); });
  for (const auto& [name, q] : kQuantiles) out[name] = Map2(a.at(name), b.at(name), average);
  out["count"] = {static_cast<int64_t>(n)};
  return out;
}

}  // namespace robostress
