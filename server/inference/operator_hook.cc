#include "server/inference/operator_hook.h"

#include <ATen/record_function.h>

#include <memory>

namespace robostress {
namespace {

using Hook = void (*)();
thread_local Hook hooked = nullptr;

std::unique_ptr<at::ObserverContext> Call(const at::RecordFunction&) {
  // LibTorch hands a callback on to threads that differentiate on a GPU, where nothing is hooked.
  if (hooked != nullptr) hooked();
  return nullptr;
}

}  // namespace

OperatorHook::OperatorHook(void (*function)())
    : handle_((hooked = function,
               at::addThreadLocalCallback(at::RecordFunctionCallback(Call).scopes(
                   {at::RecordScope::FUNCTION, at::RecordScope::BACKWARD_FUNCTION})))) {}

OperatorHook::~OperatorHook() { at::removeCallback(handle_); }

}  // namespace robostress
