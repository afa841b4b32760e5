// PCL's SAC segmentation of a cylinder, as a program that speaks the protocol of protocol.py.
//   cylinder VARIANT SCAN.pcd HINTS.json [REPEATS]
// VARIANT is SAMPLING_METHOD[_again]: sampling voxel or nth, method msac or lmeds; _again chooses the inliers anew in all
// points and refines on them. Prints the pose as one line of JSON. Must not know any other peer.

#include <pcl/features/normal_3d.h>
#include <pcl/filters/filter.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/io/pcd_io.h>
#include <pcl/point_types.h>
#include <pcl/sample_consensus/sac_model_cylinder.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/sac_segmentation.h>

#include <optional>
#include <string>
#include <vector>

#include "../protocol.hpp"

namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZ>;
using Normals = pcl::PointCloud<pcl::Normal>;
using Model = pcl::SampleConsensusModelCylinder<pcl::PointXYZ, pcl::Normal>;

/// What a variant's name says.
struct Variant {
  bool voxel, lmeds, again;
};

/// Sizes that go with a part of 200 mm radius and grow with it.
constexpr double kVoxelShare = 3.0 / 200.0;
constexpr double kNeighbourShare = 12.0 / 200.0;
/// A pair of normals misses the axis by their noise times the radius: the first search must be wider than the noise.
constexpr double kSearchShare = 1.0 / 200.0;
constexpr std::size_t kSampleCount = 20000;
constexpr std::size_t kRefineCount = 250000;

/// Every n-th point with a prime n, which is never in step with the points of a profile.
Cloud::Ptr every_nth(const Cloud& cloud, std::size_t count) {
  const std::size_t step = step_for(cloud.size(), count);
  Cloud::Ptr some(new Cloud);
  for (std::size_t i = 0; i < cloud.size(); i += step) some->push_back(cloud[i]);
  return some;
}

Cloud::Ptr voxelled(const Cloud::ConstPtr& cloud, double leaf) {
  Cloud::Ptr some(new Cloud);
  pcl::VoxelGrid<pcl::PointXYZ> grid;
  grid.setInputCloud(cloud);
  grid.setLeafSize(leaf, leaf, leaf);
  grid.filter(*some);
  return some;
}

Normals::Ptr normals_of(const Cloud::ConstPtr& cloud, double radius) {
  pcl::NormalEstimation<pcl::PointXYZ, pcl::Normal> estimation;
  estimation.setSearchMethod(pcl::search::KdTree<pcl::PointXYZ>::Ptr(new pcl::search::KdTree<pcl::PointXYZ>));
  estimation.setInputCloud(cloud);
  estimation.setRadiusSearch(radius);
  Normals::Ptr normals(new Normals);
  estimation.compute(*normals);
  return normals;
}

/// Points whose neighbourhood gave no normal are no use to the search.
void drop_without_normal(Cloud& cloud, Normals& normals) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if (!std::isfinite(normals[i].normal_x)) continue;
    cloud[kept] = cloud[i];
    normals[kept++] = normals[i];
  }
  cloud.resize(kept);
  normals.resize(kept);
}

std::vector<float> search(const Cloud::Ptr& cloud, const Normals::Ptr& normals, const Hints& hints, bool lmeds) {
  pcl::SACSegmentationFromNormals<pcl::PointXYZ, pcl::Normal> segmentation;
  segmentation.setModelType(pcl::SACMODEL_CYLINDER);
  segmentation.setMethodType(lmeds ? pcl::SAC_LMEDS : pcl::SAC_MSAC);
  segmentation.setOptimizeCoefficients(true);
  segmentation.setNormalDistanceWeight(0.0);
  segmentation.setMaxIterations(lmeds ? 500 : 2000);
  segmentation.setProbability(0.999);
  segmentation.setDistanceThreshold(std::max(3.0 * hints.noise, kSearchShare * hints.radius));
  segmentation.setRadiusLimits(hints.radius_min, hints.radius_max);
  // No setAxis: where the first candidate breaks such a limit, PCL 1.13 keeps it as unbeatable and finds nothing.
  segmentation.setInputCloud(cloud);
  segmentation.setInputNormals(normals);
  pcl::PointIndices inliers;
  pcl::ModelCoefficients found;
  segmentation.segment(inliers, found);
  return found.values;
}

/// Chooses the inliers anew, in many points and with a threshold that shrinks to three times the noise, and refines.
std::vector<float> again(const Cloud::Ptr& cloud, const std::vector<float>& start, const Hints& hints) {
  const Cloud::Ptr many = every_nth(*cloud, kRefineCount);
  Model model(many);
  model.setNormalDistanceWeight(0.0);
  // The distances ask for normals even where their weight is nothing.
  Normals::Ptr unused(new Normals);
  unused->resize(many->size());
  model.setInputNormals(unused);
  Eigen::VectorXf coefficients = Eigen::Map<const Eigen::VectorXf>(start.data(), start.size());
  for (const double widening : {4.0, 2.0, 1.0, 1.0}) {
    pcl::Indices inliers;
    model.selectWithinDistance(coefficients, widening * 3.0 * hints.noise, inliers);
    Eigen::VectorXf refined = coefficients;
    model.optimizeModelCoefficients(inliers, coefficients, refined);
    coefficients = refined;
  }
  return {coefficients.data(), coefficients.data() + coefficients.size()};
}

/// Point, direction and radius; nothing where the search found nothing.
std::optional<std::vector<float>> estimate(const Cloud::Ptr& cloud, const Hints& hints, const Variant& variant) {
  const Cloud::Ptr some = variant.voxel ? voxelled(cloud, kVoxelShare * hints.radius) : every_nth(*cloud, kSampleCount);
  // A neighbourhood must hold more than one profile.
  const double neighbourhood = std::max(kNeighbourShare * hints.radius, 1.6 * hints.pitch);
  const Normals::Ptr normals = normals_of(some, neighbourhood);
  drop_without_normal(*some, *normals);
  const std::vector<float> found = search(some, normals, hints, variant.lmeds);
  if (found.size() != 7) return std::nullopt;
  return variant.again ? again(cloud, found, hints) : found;
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 4) return 2;
  const std::string name = arguments[1];
  const auto says = [&](const char* word) { return name.find(word) != std::string::npos; };
  const Variant variant{says("voxel"), says("lmeds"), says("again")};
  const Hints hints = read_hints(arguments[3]);
  Cloud::Ptr cloud(new Cloud);
  if (pcl::io::loadPCDFile(arguments[2], *cloud) != 0) return 1;
  std::vector<int> kept;
  pcl::removeNaNFromPointCloud(*cloud, *cloud, kept);
  time_and_print(count > 4 ? std::stoi(arguments[4]) : 1, [&]() -> std::optional<Pose> {
    const auto found = estimate(cloud, hints, variant);
    if (!found) return std::nullopt;
    const auto& c = *found;
    return Pose{{c[0], c[1], c[2]}, {c[3], c[4], c[5]}, c[6]};
  });
}
