// A handler of XLA's foreign function interface for the derivatives of a batch in reverse, called from jitted JAX.
#ifndef JAXGRASP_KERNEL_XLA_PULLBACK_H
#define JAXGRASP_KERNEL_XLA_PULLBACK_H

#include "pullback.h"
#include "xla_call.h"

namespace jaxgrasp {
namespace xla {

// Entries of problem i in an array with `length` for each; null for an array that is not given.
template <class Real> inline Real* part(Real* array, long long i, int length) {
  return array == nullptr ? nullptr : array + i * length;
}

// Operands: the arrays of Batch::inputs, each (B, ...); forces, multiplier and verdict of the answers; the cotangents
// of forces, multiplier, objective, moments and normal multipliers; and 1 for the constrained optimum, 0 for the closed
// form. Results: the cotangents in the order of ProblemCotangents, and 1 where the answer has derivatives. What is not
// given has no element.
template <class Real, int MaxContacts, bool Soft, bool Bounded> inline void* pull_back(CallFrame* frame) {
  if (answers_metadata(frame)) return nullptr;
  Buffer* const* args = frame->args.buffers;
  Buffer* const* rets = frame->rets.buffers;
  constexpr int ANSWER = Batch<Real>::INPUTS, GIVEN = ANSWER + 3, CONSTRAINED = GIVEN + 5, RESULTS = 9;
  const int n = int(args[0]->dims[1]);
  const bool is_constrained = *given_data<int>(*args[CONSTRAINED]) != 0;
  Real* at[CONSTRAINED];
  Real* out[RESULTS];
  for (int j = 0; j < CONSTRAINED; j++) at[j] = j == ANSWER + 2 ? nullptr : given_data<Real>(*args[j]);
  for (int j = 0; j < RESULTS; j++) out[j] = given_data<Real>(*rets[j]);
  const int* verdict = given_data<int>(*args[ANSWER + 2]);
  int* has_derivatives = given_data<int>(*rets[RESULTS]);
  const long long count = rets[RESULTS]->dims[0];
  for (long long i = 0; i < count; i++) {
    Problem<Real> problem;
    problem.n_contacts = n;
    problem.points = part(at[0], i, 3 * n), problem.normals = part(at[1], i, 3 * n);
    problem.friction = part(at[2], i, n), problem.squeeze = part(at[3], i, n), problem.wrench = part(at[4], i, 6);
    problem.weights = part(at[5], i, n), problem.present = part(at[6], i, n), problem.torsion = part(at[7], i, n);
    problem.normal_min = part(at[8], i, n), problem.normal_max = part(at[9], i, n);
    const Answer<Real> answer = {part(at[ANSWER], i, 3 * n), part(at[ANSWER + 1], i, 6), verdict[i]};
    const AnswerCotangents<Real> given = {part(at[GIVEN], i, 3 * n), part(at[GIVEN + 1], i, 6),
                                          part(at[GIVEN + 2], i, 1), part(at[GIVEN + 3], i, n),
                                          part(at[GIVEN + 4], i, n)};
    const ProblemCotangents<Real> result = {
        part(out[0], i, 3 * n), part(out[1], i, 3 * n), part(out[2], i, n), part(out[3], i, n), part(out[4], i, 6),
        part(out[5], i, n),     part(out[6], i, n),     part(out[7], i, n), part(out[8], i, n)};
    has_derivatives[i] =
        Pullback<Real, MaxContacts, Soft, Bounded>().pull_back(problem, answer, given, is_constrained, result);
  }
  return nullptr;
}

}  // namespace xla
}  // namespace jaxgrasp

#endif
