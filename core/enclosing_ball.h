// The minimum enclosing ball: the paper's lattice is anchored to it.
#pragma once

#include <functional>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata {

struct Ball {
  Vec3 center;
  double radius = 0;  ///< World units; 0 for a single point.
};

/// The smallest ball that holds `points` (at least one, finite), in expected linear time: Welzl
/// 1991, "Smallest enclosing disks (balls and ellipsoids)", in the move-to-front form. A function
/// of the set of points: their order and multiplicity do not matter, bit for bit.
Ball EnclosingBall(std::vector<Vec3> points);

/// The smallest ball around points that are too many to hold, from three passes over them.
///
/// `for_each_point` calls its argument once for every point, in any order, any number of times for
/// one point; it is called three times. Memory: the points near the sphere.
struct StreamedBall {
  Ball ball;
  /// Every point on the sphere (to a relative 1e-9), each once: the ball is the smallest one around
  /// any set of points inside it that holds these.
  std::vector<Vec3> support;
};
using PointVisitor = std::function<void(Vec3)>;
using PointPass = std::function<Result<void>(const PointVisitor&)>;
/// Errors: those of `for_each_point`; kEmptySurface when there is no point.
Result<StreamedBall> EnclosingBallOfStream(const PointPass& for_each_point);

/// The same for vertices in memory; non-finite ones are passed over. Error: kEmptySurface.
Result<StreamedBall> EnclosingBallOfVertices(const VertexView& vertices);

}  // namespace strata
