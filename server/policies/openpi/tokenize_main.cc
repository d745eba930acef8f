// robostress tokenize MODEL: texts in, ids out, by Debian's SentencePiece. Links neither LibTorch
// nor gRPC, whose Protobuf is another one than that inside libsentencepiece (tokenizer.h).

#include <string>

#include "common/run_main.h"
#include "server/policies/openpi/tokenize_lines.h"

namespace {

constexpr char kExamples[] = R"(Examples:
  echo '"put the bowl on the plate"' | robostress tokenize paligemma_tokenizer.model

Reads one JSON string per line and writes one JSON list of ids per line, without BOS; a first line tells the number of
pieces and the special ids. An error is an object with the key "error".)";

}  // namespace

int main(int argc, char** argv) {
  robostress::cli::App app{"Tokenises text with a SentencePiece model.", "robostress tokenize"};
  app.footer(kExamples);
  std::string model;
  app.add_option("model", model, "SentencePiece model file")->required();
  return robostress::RunMain(app, argc, argv, [&] {
    return robostress::openpi::TokenizeLines(model) ? 0 : robostress::kFailed;
  });
}
