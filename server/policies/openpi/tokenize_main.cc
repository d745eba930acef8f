// robostress tokenize MODEL: texts in, ids out, by Debian's SentencePiece. Links neither LibTorch
// nor gRPC, whose Protobuf is another one than that inside libsentencepiece (tokenizer.h).

#include <sentencepiece_processor.h>

#include <cstdio>
#include <iostream>
#include <string>
#include <vector>

#include "common/run_main.h"
#include "nlohmann/json.hpp"

namespace {

using nlohmann::json;

constexpr char kExamples[] = R"(Examples:
  echo '"put the bowl on the plate"' | robostress tokenize paligemma_tokenizer.model

Reads one JSON string per line and writes one JSON list of ids per line, without BOS; a first line tells the number of
pieces and the special ids. An error is an object with the key "error".)";

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

int Tokenize(const std::string& model) {
  sentencepiece::SentencePieceProcessor processor;
  const auto loaded = processor.Load(model);
  if (!loaded.ok()) {
    Print({{"error", "is no SentencePiece model: " + loaded.ToString()}});
    return robostress::kFailed;
  }
  Print({{"pieces", processor.GetPieceSize()},
         {"bos", processor.bos_id()},
         {"eos", processor.eos_id()},
         {"unk", processor.unk_id()},
         {"pad", processor.pad_id()}});
  for (std::string line; std::getline(std::cin, line);) Print(Encode(processor, line));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Tokenises text with a SentencePiece model.", "robostress tokenize"};
  app.footer(kExamples);
  std::string model;
  app.add_option("model", model, "SentencePiece model file")->required();
  return robostress::RunMain(app, argc, argv, [&] { return Tokenize(model); });
}
