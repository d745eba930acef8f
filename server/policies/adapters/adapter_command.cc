#include "server/policies/adapters/adapter_command.h"

#include <torch/types.h>

#include <cmath>
#include <cstdio>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "adapter/adaptation_state.h"
#include "adapter/peft.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "server/policies/adapters/adapter_base.h"

namespace robostress {
namespace {

constexpr char kExamples[] = R"(Examples:
  robostress policy adapter show run/adapter.safetensors
  robostress policy adapter export --adapter run/adapter.safetensors --weights nano.safetensors --out peft
  robostress policy adapter import --peft peft --weights nano.safetensors --lora per_head --out adapter.safetensors
  robostress policy adapter merge --adapter run/adapter.safetensors --weights nano.safetensors --out merged.safetensors

An adapter file is what a session exports. --weights is the file that it was learned on. Exit code 2: bad usage or files.)";

absl::StatusOr<AdaptationState> ReadAdapter(const std::string& path, const AdapterBase& base) {
  RS_ASSIGN_OR_RETURN(std::string bytes, ReadFile(path));
  return ParseAdapter(path, std::move(bytes), base.targets, base.model_hash);
}

// Sums over phi and phi_0, from the file alone.
absl::StatusOr<nlohmann::ordered_json> Describe(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  const auto text = [&file](const char* key) {
    const auto found = file.metadata().find(key);
    return found == file.metadata().end() ? std::string() : found->second;
  };
  if (!absl::StartsWith(text("format"), "robostress-adapter-")) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": format is '", text("format"),
                     "', must be robostress-adapter-1; give a file that a session exported"));
  }
  double norm = 0, distance = 0;
  int64_t parameters = 0, rank = 0;
  for (const auto& [name, view] : file.tensors()) {
    absl::string_view rest = name;
    if (!absl::ConsumePrefix(&rest, "phi.")) continue;
    RS_ASSIGN_OR_RETURN(const std::vector<float> phi, file.ReadFloats(name));
    RS_ASSIGN_OR_RETURN(const std::vector<float> start,
                        file.ReadFloats(absl::StrCat("phi_0.", rest), view.shape));
    for (size_t i = 0; i < phi.size(); ++i) {
      norm += static_cast<double>(phi[i]) * phi[i];
      distance += std::pow(static_cast<double>(phi[i]) - start[i], 2);
    }
    parameters += view.num_elements();
    if (absl::EndsWith(rest, ".A") && view.shape.size() >= 2)
      rank = view.shape[view.shape.size() - 2];
  }
  return nlohmann::ordered_json{{"policy", text("policy")},
                                {"model_hash", text("model_hash")},
                                {"method", text("method")},
                                {"session", text("session")},
                                {"lora", text("lora").empty() ? "per_matrix" : text("lora")},
                                {"rank", rank},
                                {"parameters", parameters},
                                {"version", text("version")},
                                {"adam_steps", text("adam_steps")},
                                {"norm", std::sqrt(norm)},
                                {"distance", std::sqrt(distance)},
                                {"last_task", text("task")},
                                {"feedback_sequence", text("feedback_sequence")},
                                {"buffered_chunks", text("buffered")}};
}

absl::Status Show(const std::string& path, bool json) {
  RS_ASSIGN_OR_RETURN(const nlohmann::ordered_json facts, Describe(path));
  if (json) {
    std::printf("%s\n", facts.dump(2).c_str());
    return absl::OkStatus();
  }
  for (const auto& [key, value] : facts.items()) {
    std::printf("%-18s %s\n", key.c_str(),
                value.is_string() ? value.get<std::string>().c_str() : value.dump().c_str());
  }
  return absl::OkStatus();
}

absl::Status Export(const std::string& adapter, const std::string& weights,
                    const std::string& folder) {
  RS_ASSIGN_OR_RETURN(const AdapterBase base, OpenAdapterBase(weights));
  RS_ASSIGN_OR_RETURN(const AdaptationState state, ReadAdapter(adapter, base));
  RS_ASSIGN_OR_RETURN(const PeftFiles files,
                      ToPeft(base.targets, base.module_root, state.lora.phi));
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(absl::StrCat(folder, "/", kPeftTensors), files.safetensors));
  return WriteFileAtomically(absl::StrCat(folder, "/", kPeftConfig), files.config_json);
}

// A state that a session continues from: the imported adapter as version 1, anchored at the same A
// with B = 0, the unadapted policy, which is also version 0 for a roll-back; nothing buffered.
absl::Status Import(const std::string& folder, const std::string& weights, LoraKind kind,
                    const std::string& policy, const std::string& method,
                    const std::string& model_hash, const std::string& out) {
  RS_ASSIGN_OR_RETURN(const AdapterBase base, OpenAdapterBase(weights));
  if (base.model_hash.empty() && model_hash.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        weights,
        ": what a policy of pi0 computes depends on its tokenizer and statistics too; give "
        "--model-hash as `robostress serve` prints it"));
  }
  PeftFiles files;
  RS_ASSIGN_OR_RETURN(files.safetensors, ReadFile(absl::StrCat(folder, "/", kPeftTensors)));
  RS_ASSIGN_OR_RETURN(files.config_json, ReadFile(absl::StrCat(folder, "/", kPeftConfig)));
  AdaptationState state;
  RS_ASSIGN_OR_RETURN(state.lora.phi,
                      FromPeft(folder, files, base.targets, base.module_root, kind));
  state.lora.phi.version = 1;
  state.lora.phi_0.A = state.lora.phi.A;
  for (const torch::Tensor& B : state.lora.phi.B)
    state.lora.phi_0.B.push_back(torch::zeros_like(B));
  state.lora.adam = InitialAdamState(Parameters(state.lora.phi));
  state.policy = policy;
  state.model_hash = model_hash.empty() ? base.model_hash : model_hash;
  state.method = method;
  state.lora_kind = kind;
  state.session = absl::StrCat("imported from ", folder);
  RS_ASSIGN_OR_RETURN(const std::string bytes, SerializeAdaptationState(state, base.targets));
  return WriteFileAtomically(out, bytes);
}

absl::Status Merge(const std::string& adapter, const std::string& weights, const std::string& out) {
  RS_ASSIGN_OR_RETURN(const AdapterBase base, OpenAdapterBase(weights));
  RS_ASSIGN_OR_RETURN(const AdaptationState state, ReadAdapter(adapter, base));
  return WriteMerged(base, state.lora.phi, out);
}

}  // namespace

AdapterCommand::AdapterCommand(cli::App& app)
    : command_(app.add_subcommand("adapter", "Show, export, import and merge adapters")),
      show_(command_->add_subcommand("show", "Print what an adapter file holds")),
      export_(command_->add_subcommand("export", "Write an adapter as a PEFT folder")),
      import_(command_->add_subcommand("import", "Make an adapter file of a PEFT folder")),
      merge_(command_->add_subcommand("merge", "Write weights with the adapter added to them")) {
  command_->require_subcommand(1);
  command_->footer(kExamples);
  show_->add_option("adapter", adapter_, "adapter file")->required();
  show_->add_flag("--json", json_, "print one JSON object");
  for (cli::App* sub : {export_, merge_})
    sub->add_option("--adapter", adapter_, "adapter file")->required();
  for (cli::App* sub : {export_, import_, merge_})
    sub->add_option("--weights", weights_, "weights file of nano or with openpi's tensor names")
        ->required();
  import_
      ->add_option("--peft", peft_, "folder with adapter_model.safetensors and adapter_config.json")
      ->required();
  import_->add_option("--lora", kind_, "per_matrix, or per_head for an exported adapter per head")
      ->check(cli::IsMember({"per_head", "per_matrix"}))
      ->capture_default_str();
  import_->add_option("--policy", policy_, "name of the policy that the weights are served under")
      ->capture_default_str();
  import_->add_option("--method", method_, "method of the sessions that take it")
      ->capture_default_str();
  import_->add_option("--model-hash", model_hash_,
                      "hash of the served policy (default: of nano's weights)");
  export_->add_option("--out", out_, "folder to write")->required();
  for (cli::App* sub : {import_, merge_})
    sub->add_option("--out", out_, "file to write")->required();
}

int AdapterCommand::Run() const {
  absl::Status status;
  try {
    torch::NoGradGuard no_grad;
    const LoraKind kind = kind_ == "per_head" ? LoraKind::kPerHead : LoraKind::kPerMatrix;
    status = show_->parsed()     ? Show(adapter_, json_)
             : export_->parsed() ? Export(adapter_, weights_, out_)
             : import_->parsed()
                 ? Import(peft_, weights_, kind, policy_, method_, model_hash_, out_)
                 : Merge(adapter_, weights_, out_);
  } catch (const std::exception& error) {  // LibTorch: out of memory and the like
    status = absl::InternalError(error.what());
  }
  if (status.ok()) return 0;
  std::fprintf(stderr, "robostress-policy: %s\n", std::string(status.message()).c_str());
  return 2;
}

}  // namespace robostress
