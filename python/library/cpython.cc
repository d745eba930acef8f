#include <cstddef>
#include <cstring>

#include "python/library/errors_object.h"
#include "python/library/robostress.h"

// A sub-step as a built-in function of CPython, for the wheel: a call through ctypes takes three
// microseconds where a simulator has emptied the caches. No Python is linked: these are the stable
// functions of the interpreter that has loaded the library, NULL elsewhere.
extern "C" {

struct PyObject;
struct Py_buffer {
  void* data;
  PyObject* owner;
  ptrdiff_t size, item_size;
  int read_only, dimensions;
  char* format;
  ptrdiff_t *shape, *strides, *suboffsets;
  void* internal;
};

#define ROBOSTRESS_OF_CPYTHON __attribute__((weak))
ROBOSTRESS_OF_CPYTHON PyObject* PyTuple_GetItem(PyObject*, ptrdiff_t);  // borrowed
ROBOSTRESS_OF_CPYTHON void* PyLong_AsVoidPtr(PyObject*);
ROBOSTRESS_OF_CPYTHON PyObject* PyObject_GetAttr(PyObject*, PyObject*);
ROBOSTRESS_OF_CPYTHON int PyObject_GetBuffer(PyObject*, Py_buffer*, int);
ROBOSTRESS_OF_CPYTHON void PyBuffer_Release(Py_buffer*);
ROBOSTRESS_OF_CPYTHON PyObject* PyObject_CallFunctionObjArgs(PyObject*, ...);
ROBOSTRESS_OF_CPYTHON int PyErr_ExceptionMatches(PyObject*);
ROBOSTRESS_OF_CPYTHON void PyErr_Clear();
ROBOSTRESS_OF_CPYTHON void Py_DecRef(PyObject*);
ROBOSTRESS_OF_CPYTHON extern PyObject* PyExc_Exception;
#undef ROBOSTRESS_OF_CPYTHON

}  // extern "C"

namespace robostress {
namespace {

// Of the tuple that the function is bound to, which keeps all of it: JointErrors.sub_step_of().
enum Part : ptrdiff_t { kErrors, kAsked, kController, kTorques, kPhysics, kOtherwise };

template <class Value>
Value* PointerIn(PyObject* bound, Part part) {
  return static_cast<Value*>(PyLong_AsVoidPtr(PyTuple_GetItem(bound, part)));
}

enum class Taken { kYes, kNo, kInterrupted };

// Takes `joints` doubles in a row; nothing else.
Taken Take(PyObject* torques, size_t joints, double* asked) {
  constexpr int kContiguousWithFormat = 0x4 | 0x8;  // PyBUF_FORMAT | PyBUF_ND
  Py_buffer buffer = {};
  if (PyObject_GetBuffer(torques, &buffer, kContiguousWithFormat) != 0) {
    if (!PyErr_ExceptionMatches(PyExc_Exception)) return Taken::kInterrupted;
    PyErr_Clear();
    return Taken::kNo;
  }
  const bool fits = buffer.dimensions == 1 && buffer.format != nullptr &&
                    std::strcmp(buffer.format, "d") == 0 &&
                    static_cast<size_t>(buffer.size) == joints * sizeof(double);
  if (fits) std::memcpy(asked, buffer.data, joints * sizeof(double));
  PyBuffer_Release(&buffer);
  return fits ? Taken::kYes : Taken::kNo;
}

PyObject* GoOn(PyObject* bound, PyObject* torques) {
  auto* errors = PointerIn<robostress_errors>(bound, kErrors);
  const Taken taken =
      Take(torques, static_cast<size_t>(errors->chain.joints()), PointerIn<double>(bound, kAsked));
  if (taken == Taken::kInterrupted) return nullptr;
  if (taken == Taken::kYes && robostress_errors_act_attached(errors, nullptr, 0) == ROBOSTRESS_OK) {
    return PyObject_CallFunctionObjArgs(PyTuple_GetItem(bound, kPhysics), nullptr);
  }
  return PyObject_CallFunctionObjArgs(PyTuple_GetItem(bound, kOtherwise), torques, nullptr);
}

// The errors act on what the controller asks for, then the physics goes on. Where they cannot,
// another function does both with the same torques, and says why.
PyObject* SubStep(PyObject* bound, PyObject*) {
  PyObject* torques =
      PyObject_GetAttr(PyTuple_GetItem(bound, kController), PyTuple_GetItem(bound, kTorques));
  if (torques == nullptr) return nullptr;
  PyObject* result = GoOn(bound, torques);
  Py_DecRef(torques);
  return result;
}

struct PyMethodDef {
  const char* name;
  PyObject* (*function)(PyObject*, PyObject*);
  int flags;
  const char* text;
};
constexpr int kAnyArguments = 0x1;  // METH_VARARGS
PyMethodDef sub_step = {"sub_step", SubStep, kAnyArguments, nullptr};

}  // namespace
}  // namespace robostress

extern "C" void* robostress_cpython_sub_step(void) {
  const bool here = PyTuple_GetItem && PyLong_AsVoidPtr && PyObject_GetAttr && PyObject_GetBuffer &&
                    PyBuffer_Release && PyObject_CallFunctionObjArgs && PyErr_ExceptionMatches &&
                    PyErr_Clear && Py_DecRef && &PyExc_Exception;
  return here ? &robostress::sub_step : nullptr;
}
