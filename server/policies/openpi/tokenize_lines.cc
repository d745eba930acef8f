#include "server/policies/openpi/tokenize_lines.h"

#include <sentencepiece_processor.h>

#include <iostream>
#include <vector>

#include "nlohmann/json.hpp"

namespace robostress::openpi {
namespace {

using nlohmann::json;

void Print(const json& value) {
  std::cout << value.dump(-1, ' ', false, json::error_handler_t::replace) << '\n' << std::flush;
}

json Encode(const sentencepiece::SentencePieceProcessor& processor, const std::string& line) {
  const json text = json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!text.is_string()) return {{"error", "line is not a JSON string: " + line.substr(0, 80)}};
  std::vector<int> ids;
  const auto status = processor.Encode(text.get<std::string>(), &ids);
  if (!status.ok()) return {{"error", status.ToString()}};
  return ids;
}

}  // namespace

bool TokenizeLines(const std::string& model) {
  sentencepiece::SentencePieceProcessor processor;
  const auto loaded = processor.Load(model);
  if (!loaded.ok()) {
    Print({{"error", "is no SentencePiece model: " + loaded.ToString()}});
    return false;
  }
  Print({{"pieces", processor.GetPieceSize()},
         {"bos", processor.bos_id()},
         {"eos", processor.eos_id()},
         {"unk", processor.unk_id()},
         {"pad", processor.pad_id()}});
  for (std::string line; std::getline(std::cin, line);) Print(Encode(processor, line));
  return true;
}

}  // namespace robostress::openpi
