// Verified strides of the simplest walker with CAPD, one box at a time (Kapela, Mrozek, Wilczak and
// Zgliczynski 2021, doi:10.1016/j.cnsns.2020.105578), to compare with the package's own.
//
// How to build it, with CAPD 6.1 built before (cmake -DCMAKE_BUILD_TYPE=Release
// -DCMAKE_CXX_FLAGS=-march=native, then make), and to run the comparison:
//
//     c++ capd_stride.cpp $(BUILD/bin/capd-config --cflags --libs) -O3 -march=native -o capd_stride
//     python benchmarks/proofs_capd.py ./capd_stride
//
// Arguments are C0 or C1, the order and tolerance of the series, half the width of a box, and
// rounds. Each line of the input is the middle of a box, theta and thetadot just after heel strike.
// Each line of the output has bounds of the next theta and thetadot, or `open`; the last line has
// the processor time of a stride in seconds, the median of the rounds.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>
#include <vector>

#include "capd/capdlib.h"
// Vectors whose size is known to the compiler are faster.
#define CAPD_DEFAULT_DIMENSION 4
#define CAPD_USER_NAMESPACE capd4
#include "capd/fdcapdlib.h"

using namespace capd4;
using capd::interval;

struct Box {
  interval theta, thetadot;
};

// The equations of SimplestWalker; the slope is any number that rounds to 0.004.
const char *EQUATIONS =
    "par:slope;var:theta,phi,w,v;"
    "fun:w,v,sin(theta-slope),sin(phi)*(w^2-cos(theta-slope))+sin(theta-slope);";
const interval SLOPE = interval(4.0) / interval(1000.0);

interval middle(const interval &x) { return interval(x.mid().leftBound()); }

// The stance leg is in compression. That is least so at the ends of a stride.
bool pushes(const interval &theta, const interval &w) {
  return w * w - cos(theta - SLOPE) < 0.0;
}

// The impact takes (theta, w) to (-theta, cos(2 theta) w).
interval struck(const interval &theta, const interval &w) { return cos(2.0 * theta) * w; }
interval struck_by_theta(const interval &theta, const interval &w) {
  return -2.0 * sin(2.0 * theta) * w;
}
interval struck_by_w(const interval &theta) { return cos(2.0 * theta); }

// All states of a box just after heel strike, (theta, 2 theta, w, w - cos(2 theta) w): linear in
// the place in the box, but for a small remainder.
template <class Set> Set lift(const Box &box) {
  interval c = middle(box.theta), d = middle(box.thetadot), v = d - struck(c, d);
  interval a = box.theta - c, b = box.thetadot - d;
  interval by_theta = middle(-struck_by_theta(c, d)), by_w = middle(1.0 - struck_by_w(c));
  IVector x(4), size(4), rest(4);
  IMatrix sides(4, 4);
  x[0] = c, x[1] = 2.0 * c, x[2] = d, x[3] = middle(v);
  size[0] = a, size[1] = b;
  sides[0][0] = 1.0, sides[1][0] = 2.0, sides[2][1] = 1.0;
  sides[3][0] = by_theta, sides[3][1] = by_w;
  rest[3] = v - middle(v) + (-struck_by_theta(box.theta, box.thetadot) - by_theta) * a +
            (1.0 - struck_by_w(box.theta) - by_w) * b;
  return Set(x, sides, size, rest);
}

// A stride may begin: beyond pi / 4 no impact leaves the walker going on.
bool feasible(const Box &box) {
  return box.theta > 0.0 && box.theta < 0.7853981 && box.thetadot < 0.0;
}

// The stance leg never stops, having more energy than at the top, and it is pushed at the start.
bool may_walk(const Box &box) {
  interval energy = box.thetadot * box.thetadot / 2.0 + cos(box.theta - SLOPE);
  return energy > 1.0 && feasible(box) && pushes(box.theta, box.thetadot);
}

// Leave the start, where the contact coordinate phi - 2 theta is zero, and go on until the swing
// foot has passed. As in the package, a strike is a rise through zero with theta < 0: scuffing is
// none.
template <class Set> bool pass(IOdeSolver &solver, Set &set) {
  IVector now(4);
  do {
    solver(set);
    const IVector &way = set.getLastEnclosure();
    interval contact = way[1] - 2.0 * way[0], rate = way[3] - 2.0 * way[2];
    if (!(contact < 0.0 || contact > 0.0 || rate < 0.0 || way[0] > 0.0)) return false;
    now = IVector(set);
  } while (!(now[1] - 2.0 * now[0] < 0.0));
  return true;
}

template <class Vector> Vector contact_gradient() {
  Vector n(4);
  n[0] = -2.0, n[1] = 1.0;
  return n;
}

struct Walker {
  IMap equations = IMap(EQUATIONS);
  IOdeSolver solver;
  IAffineSection section = IAffineSection(IVector(4), contact_gradient<IVector>());
  IPoincareMap to_strike; // a rise of the contact coordinate
  // The same in plain floating point, for guesses.
  DMap plain_equations = DMap(EQUATIONS);
  DOdeSolver plain_solver = DOdeSolver(plain_equations, 8);
  DAffineSection plain_section = DAffineSection(DVector(4), contact_gradient<DVector>());
  DPoincareMap to_plain_strike =
      DPoincareMap(plain_solver, plain_section, capd::poincare::MinusPlus);

  Walker(int order, double tolerance)
      : solver(equations, order), to_strike(solver, section, capd::poincare::MinusPlus) {
    equations.setParameter("slope", SLOPE);
    solver.setAbsoluteTolerance(tolerance);
    solver.setRelativeTolerance(tolerance);
    plain_equations.setParameter("slope", 0.004);
    plain_solver.setAbsoluteTolerance(1e-10);
    plain_solver.setRelativeTolerance(1e-10);
  }

  // About the strike of a start.
  IVector guess(const Box &start) {
    double theta = start.theta.mid().leftBound(), w = start.thetadot.mid().leftBound();
    DVector x(4);
    x[0] = theta, x[1] = 2.0 * theta, x[2] = w, x[3] = (1.0 - std::cos(2.0 * theta)) * w;
    x = to_plain_strike(x);
    IVector near(4);
    for (int i = 0; i < 4; ++i) near[i] = x[i];
    near[1] = 2.0 * near[0];
    return near;
  }

  // Coordinates for the neighbourhood of a strike: theta, the linear part of the impact, and w. A
  // multiple of the contact coordinate, zero there, is added, with which they do not change with
  // time: bounds of the time of the strike then cost no width.
  IMatrix coordinates(const IVector &near) {
    IMatrix along(4, 4);
    along[0][0] = along[2][2] = 1.0;
    along[1][0] = struck_by_theta(near[0], near[2]), along[1][2] = middle(struck_by_w(near[0]));
    IVector rates = equations(near), moved = along * rates;
    for (int i = 0; i < 3; ++i) {
      interval multiple = -moved[i] / (rates[1] - 2.0 * rates[0]);
      along[i][0] = middle(along[i][0] - 2.0 * multiple), along[i][1] = middle(multiple);
    }
    return along;
  }

  bool stride(const Box &box, Box &next) {
    interval time;
    C0Rect2Set set = lift<C0Rect2Set>(box);
    if (!may_walk(box) || !pass(solver, set)) return false;
    IVector near = guess(box);
    IMatrix along = coordinates(near);
    IVector y = to_strike(set, near, along, time);
    auto by_theta = [&](int i) { return along[i][0] + 2.0 * along[i][1]; };
    interval theta = near[0] + y[0] / by_theta(0);
    interval w = near[2] + y[2] - by_theta(2) * (theta - near[0]);
    // The rest of the impact has small derivatives, and is bounded by its mean value.
    interval p = middle(theta), q = middle(w);
    interval rest = struck(p, q) - by_theta(1) * (p - near[0]) - along[1][2] * (q - near[2]) +
                    (struck_by_theta(theta, w) - by_theta(1)) * (theta - p) +
                    (struck_by_w(theta) - along[1][2]) * (w - q);
    next = {-theta, y[1] + rest};
    return pushes(theta, w) && feasible(next);
  }

  // The same by the mean value, S(c) + DS (x - c), with the derivatives DS over the whole box.
  bool stride_with_derivatives(const Box &box, Box &next) {
    interval time, c = middle(box.theta), d = middle(box.thetadot);
    C1Rect2Set set = lift<C1Rect2Set>(box);
    if (!may_walk(box) || !pass(solver, set) || !stride({c, d}, next)) return false;
    IMatrix flow(4, 4), lifted(4, 2), impact(2, 4);
    IVector x = to_strike(set, flow, time);
    lifted[0][0] = lifted[2][1] = 1.0, lifted[1][0] = 2.0;
    lifted[3][0] = -struck_by_theta(box.theta, box.thetadot);
    lifted[3][1] = 1.0 - struck_by_w(box.theta);
    impact[0][0] = -1.0;
    impact[1][0] = struck_by_theta(x[0], x[2]), impact[1][2] = struck_by_w(x[0]);
    flow = to_strike.computeDP(x, flow, time);
    interval by[4];
    for (int i = 0; i < 4; ++i) {
      by[i] = 0.0;
      for (int j = 0; j < 16; ++j)
        by[i] += impact[i / 2][j / 4] * flow[j / 4][j % 4] * lifted[j % 4][i % 2];
    }
    interval a = box.theta - c, b = box.thetadot - d;
    next = {next.theta + by[0] * a + by[1] * b, next.thetadot + by[2] * a + by[3] * b};
    intersection(next.theta, -x[0], next.theta);
    intersection(next.thetadot, struck(x[0], x[2]), next.thetadot);
    return pushes(x[0], x[2]) && feasible(next);
  }
};

double processor_time() { return double(std::clock()) / CLOCKS_PER_SEC; }

int main(int count, char **given) {
  if (count != 6) return std::fprintf(stderr, "C0|C1 ORDER TOLERANCE HALF_WIDTH ROUNDS\n"), 2;
  bool derivatives = std::string(given[1]) == "C1";
  double half = std::atof(given[4]), theta, thetadot;
  interval side(-half, half);
  std::vector<Box> boxes;
  while (std::scanf("%lf %lf", &theta, &thetadot) == 2)
    boxes.push_back({theta + side, thetadot + side});
  Walker walker(std::atoi(given[2]), std::atof(given[3]));
  std::vector<Box> next(boxes.size());
  std::vector<bool> proved(boxes.size());
  std::vector<double> times;
  for (int round = 0; round <= std::atoi(given[5]); ++round) {
    double start = processor_time();
    for (size_t i = 0; i < boxes.size(); ++i) try {
        proved[i] = derivatives ? walker.stride_with_derivatives(boxes[i], next[i])
                                : walker.stride(boxes[i], next[i]);
      } catch (const std::exception &) { // no step, or the section is not crossed transversally
        proved[i] = false;
      }
    if (round > 0) times.push_back((processor_time() - start) / boxes.size()); // after a warm-up
  }
  for (size_t i = 0; i < boxes.size(); ++i) {
    const interval &a = next[i].theta, &b = next[i].thetadot;
    if (proved[i])
      std::printf("%.17g %.17g %.17g %.17g\n", a.leftBound(), a.rightBound(), b.leftBound(),
                  b.rightBound());
    else
      std::printf("open\n");
  }
  std::sort(times.begin(), times.end());
  std::printf("%.6g\n", times.at(times.size() / 2));
}
