// Thresholds in the scaled coordinates, which jaxgrasp/problem/tolerances.py explains.
// `python -m jaxgrasp.kernel.tolerances_header` generates this file: do not edit.
#ifndef JAXGRASP_KERNEL_TOLERANCES_H
#define JAXGRASP_KERNEL_TOLERANCES_H

namespace jaxgrasp {

template <class Real> struct Tolerances;

template <> struct Tolerances<double> {
  static constexpr double rank = 1.4210854715202004e-14;
  static constexpr double range = 9.313225746154785e-10;
  static constexpr double pivot = 0.0001220703125;
  static constexpr double singular = 1.1028289493045307e-11;
  static constexpr double gradient = 1.8189894035458565e-12;
  static constexpr double gap = 2.3283064365386963e-10;
  static constexpr double balance = 7.450580596923828e-09;
  static constexpr double torque = 6.055454452393343e-06;
  static constexpr double sums = 3.552713678800501e-15;
  static constexpr double largest = 2.0039469665719525e+123;
  static constexpr double largest_load = 9.167764923824869e+147;
  static constexpr double smallest = 8.688359301097968e-124;
  static constexpr double proof = 4194304.0;
};

template <> struct Tolerances<float> {
  static constexpr float rank = float(7.62939453125e-06);
  static constexpr float range = float(2.1579186437577746e-05);
  static constexpr float pivot = float(0.018581361171917516);
  static constexpr float singular = float(1.4236953606213502e-05);
  static constexpr float gradient = float(6.4155305118844185e-06);
  static constexpr float gap = float(5.3947966093944364e-06);
  static constexpr float balance = float(0.00017263349150062197);
  static constexpr float torque = float(0.00492156660115185);
  static constexpr float sums = float(1.9073486328125e-06);
  static constexpr float largest = float(2586638680092605.0);
  static constexpr float largest_load = float(3.1281165152181187e+18);
  static constexpr float smallest = float(6.731133723782512e-16);
  static constexpr float proof = float(181.01933598375615);
};

}  // namespace jaxgrasp

#endif
