// CGAL's Efficient RANSAC (Schnabel, Wahl and Klein, 2007), the algorithm behind CloudCompare's RANSAC plugin, as a program
// that speaks the protocol of protocol.py.
//   cylinder efficient_ransac SCAN.pcd HINTS.json [REPEATS]
// Reads every n-th point, estimates normals, detects cylinders and takes the one with the most points whose radius is within
// the range. Prints the pose as one line of JSON. Must not know any other peer.

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Point_with_normal_3.h>
#include <CGAL/Shape_detection/Efficient_RANSAC.h>
#include <CGAL/jet_estimate_normals.h>
#include <CGAL/property_map.h>

#include <cmath>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "../protocol.hpp"

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = std::pair<Kernel::Point_3, Kernel::Vector_3>;
using PointMap = CGAL::First_of_pair_property_map<Point>;
using NormalMap = CGAL::Second_of_pair_property_map<Point>;
using Traits = CGAL::Shape_detection::Efficient_RANSAC_traits<Kernel, std::vector<Point>, PointMap, NormalMap>;
using Ransac = CGAL::Shape_detection::Efficient_RANSAC<Traits>;
using Cylinder = CGAL::Shape_detection::Cylinder<Traits>;

/// As the other peers that search in a sample.
constexpr std::size_t kSampleCount = 20000;
/// Neighbours of a normal: with 20 000 points of a part of 200 mm radius they lie within 12 mm, as those of PCL do.
constexpr unsigned kNeighbours = 24;
/// A shape has at least so much of the points.
constexpr double kLeastShare = 0.05;

/// The finite points of a binary PCD with single-precision x, y and z.
std::vector<Kernel::Point_3> read_pcd(const char* path) {
  std::ifstream file(path, std::ios::binary);
  for (std::string line; std::getline(file, line) && line != "DATA binary";) {
  }
  std::vector<Kernel::Point_3> points;
  for (float xyz[3]; file.read(reinterpret_cast<char*>(xyz), sizeof xyz);)
    if (std::isfinite(xyz[2])) points.emplace_back(xyz[0], xyz[1], xyz[2]);
  return points;
}

/// Every n-th point with a prime n, which is never in step with the points of a profile.
std::vector<Point> every_nth(const std::vector<Kernel::Point_3>& all, std::size_t count) {
  const std::size_t step = step_for(all.size(), count);
  std::vector<Point> some;
  for (std::size_t i = 0; i < all.size(); i += step) some.emplace_back(all[i], Kernel::Vector_3(0, 0, 0));
  return some;
}

std::optional<Pose> estimate(const std::vector<Kernel::Point_3>& all, const Hints& hints) {
  std::vector<Point> points = every_nth(all, kSampleCount);
  CGAL::jet_estimate_normals<CGAL::Sequential_tag>(
      points, kNeighbours, CGAL::parameters::point_map(PointMap()).normal_map(NormalMap()));
  CGAL::get_default_random() = CGAL::Random(0);
  Ransac ransac;
  ransac.set_input(points);
  ransac.add_shape_factory<Cylinder>();
  Ransac::Parameters parameters;
  parameters.probability = 0.001;
  parameters.min_points = static_cast<std::size_t>(kLeastShare * points.size());
  parameters.epsilon = 3.0 * hints.noise;
  parameters.normal_threshold = 0.9;
  // Connected over the profiles, and over the points of a profile in the sample.
  parameters.cluster_epsilon = std::max(0.06 * hints.radius, 2.0 * hints.pitch);
  ransac.detect(parameters);
  std::optional<Pose> best;
  std::size_t most = 0;
  for (const auto& shape : ransac.shapes()) {
    const auto* cylinder = dynamic_cast<const Cylinder*>(shape.get());
    if (cylinder == nullptr || cylinder->radius() < hints.radius_min || cylinder->radius() > hints.radius_max) continue;
    const std::size_t count = cylinder->indices_of_assigned_points().size();
    if (count <= most) continue;
    most = count;
    const auto axis = cylinder->axis();
    const auto at = axis.point(0);
    const auto along = axis.to_vector();
    best = Pose{{at.x(), at.y(), at.z()}, {along.x(), along.y(), along.z()}, cylinder->radius()};
  }
  return best;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 4) return 2;
  const Hints hints = read_hints(arguments[3]);
  const std::vector<Kernel::Point_3> points = read_pcd(arguments[2]);
  if (points.empty()) return 1;
  time_and_print(count > 4 ? std::stoi(arguments[4]) : 1, [&] { return estimate(points, hints); });
}
