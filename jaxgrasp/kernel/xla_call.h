// A handler of XLA's foreign function interface that solves a batch on the processor, called from jitted JAX.
//
// The structures are the beginning of those of xla/ffi/api/c_api.h, whose binary interface XLA keeps: they may grow
// behind the members that are read here. They are repeated since that header needs a standard library.
#ifndef JAXGRASP_KERNEL_XLA_CALL_H
#define JAXGRASP_KERNEL_XLA_CALL_H

#include "batch.h"

namespace jaxgrasp {
namespace xla {

typedef unsigned long long Size;

struct Version {
  Size struct_size;
  void* extension_start;
  int major_version, minor_version;
};
struct Metadata {
  Size struct_size;
  Version api_version;
  unsigned traits;
};
// XLA asks for the version by a call with this extension.
struct Extension {
  Size struct_size;
  int type;  // METADATA, or another that is of no interest here.
  Extension* next;
};
struct MetadataExtension {
  Extension base;
  Metadata* metadata;
};
static constexpr int METADATA = 1, API_MAJOR_VERSION = 0, API_MINOR_VERSION = 1;

struct Buffer {
  Size struct_size;
  void* extension_start;
  int dtype;
  void* data;
  long long rank;
  const long long* dims;
};
struct Buffers {
  Size struct_size;
  void* extension_start;
  long long size;
  int* types;
  Buffer** buffers;
};
struct CallFrame {
  Size struct_size;
  Extension* extension_start;
  const void* api;
  void* context;
  int stage;
  Buffers args, rets;
};

// Whether XLA only asks for the version of the interface, which this answers.
inline bool answers_metadata(CallFrame* frame) {
  if (frame->extension_start == nullptr || frame->extension_start->type != METADATA) return false;
  Metadata* metadata = reinterpret_cast<MetadataExtension*>(frame->extension_start)->metadata;
  metadata->api_version.major_version = API_MAJOR_VERSION;
  metadata->api_version.minor_version = API_MINOR_VERSION;
  return true;
}

// The numbers of an operand or result; null for one without an element, which is not given.
template <class Real> inline Real* given_data(const Buffer& buffer) {
  for (int axis = 0; axis < buffer.rank; axis++)
    if (buffer.dims[axis] == 0) return nullptr;
  return static_cast<Real*>(buffer.data);
}

// Arrays of one solution, in the order of the results.
template <class Real> inline SolutionArrays<Real> solution_arrays(Buffer* const* rets) {
  Real* reals[8];
  int* codes[4];
  for (int i = 0; i < 8; i++) reals[i] = static_cast<Real*>(rets[i]->data);
  for (int i = 0; i < 4; i++) codes[i] = static_cast<int*>(rets[8 + i]->data);
  return {reals[0], reals[1], reals[2], reals[3], reals[4], reals[5], reals[6], reals[7],
          codes[0], codes[1], codes[2], codes[3]};
}

static constexpr int RESULTS = 12;

// Operands: the arrays of Batch::inputs, each (B, ...) or (1, ...), those that are not given with no element. Results:
// 12 arrays for each solution that is wanted: (closed form, optimum) where there are 24, else the optimum, or the
// closed form where `ClosedForm`. The caller, jaxgrasp/solver/in_kernel.py, makes shapes that fit.
template <class Real, int MaxContacts, bool Soft, bool Bounded, bool ClosedForm> inline void* solve(CallFrame* frame) {
  if (answers_metadata(frame)) return nullptr;
  Batch<Real> batch;
  for (int i = 0; i < Batch<Real>::INPUTS; i++) {
    batch.inputs[i] = given_data<Real>(*frame->args.buffers[i]);
    batch.strides[i] = frame->args.buffers[i]->dims[0] != 1;
  }
  Buffer* const* rets = frame->rets.buffers;
  const long long* dims = rets[0]->dims;  // Forces: (B, n, 3).
  batch.n_contacts = dims[1];
  const bool has_both = frame->rets.size == 2 * RESULTS;
  const SolutionArrays<Real> first = solution_arrays<Real>(rets);
  batch.closed_form = has_both || ClosedForm ? first : SolutionArrays<Real>{};
  batch.optimum = has_both ? solution_arrays<Real>(rets + RESULTS) : ClosedForm ? SolutionArrays<Real>{} : first;
  for (long long i = 0; i < dims[0]; i++) solve_in_batch<Real, MaxContacts, Soft, Bounded>(batch, i);
  return nullptr;
}

}  // namespace xla
}  // namespace jaxgrasp

#endif
