#include "io/gltf_pose.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

namespace strata::io {
namespace {

struct Target {
  double weight;
  GltfValues moves;
};
// Four numbers for each vertex: an accessor's, or what Draco data held.
struct Fours {
  std::optional<GltfValues> stored;
  std::vector<double> decoded;

  Result<void> Read(std::uint64_t first, std::span<double> out) {
    if (stored) return stored->Read(first, out);
    std::copy_n(decoded.begin() + static_cast<std::ptrdiff_t>(4 * first), out.size(), out.begin());
    return {};
  }
};
// What a joint has to say about a vertex.
struct Pull {
  const Affine* joint;
  double weight;
};
// One of the pairs JOINTS_n, WEIGHTS_n.
struct Influence {
  Fours joints, weights;
};

tl::unexpected<Error> Corrupt(const GltfBuffers& buffers, const GltfDraw& draw,
                              const std::string& what) {
  return Fail(ErrorCode::kCorruptInput, buffers.name() + ": /meshes/" + std::to_string(draw.mesh) +
                                            "/primitives/" + std::to_string(draw.primitive) + what);
}

class Pose : public GltfPose {
 public:
  Pose(GltfBuffers& buffers, const GltfDraw& draw) : buffers_(buffers), draw_(draw) {}

  Result<void> OpenTargets(const GltfDocument& document, const char* key,
                           std::vector<Target>& opened) {
    const GltfMesh& mesh = document.meshes[draw_.mesh];
    const auto& targets = mesh.primitives[draw_.primitive].targets;
    const std::vector<double>& weights =
        draw_.posed_by && !document.nodes[*draw_.posed_by].weights.empty()
            ? document.nodes[*draw_.posed_by].weights
            : mesh.weights;
    for (std::size_t i = 0; i < targets.size() && i < weights.size(); ++i) {
      const auto found = targets[i].find(key);
      if (weights[i] == 0 || found == targets[i].end()) continue;
      auto moves = Vec(document, found->second, 3);
      if (!moves) return Forward(moves);
      opened.push_back({weights[i], std::move(*moves)});
    }
    return {};
  }
  Result<void> OpenTargets(const GltfDocument& document, bool normals) {
    if (auto ok = OpenTargets(document, "POSITION", targets_); !ok) return ok;
    return normals ? OpenTargets(document, "NORMAL", normal_targets_) : Result<void>();
  }

  Result<void> OpenSkin(const GltfDocument& document, const GltfScene& scene,
                        const DracoMesh* draco) {
    if (!draw_.posed_by || !document.nodes[*draw_.posed_by].skin) return {};
    const auto& attributes = document.meshes[draw_.mesh].primitives[draw_.primitive].attributes;
    for (int set = 0;; ++set) {
      const std::string joints = "JOINTS_" + std::to_string(set);
      const std::string weights = "WEIGHTS_" + std::to_string(set);
      if (!attributes.contains(joints) || !attributes.contains(weights)) break;
      auto j = OpenFours(document, joints, draco);
      if (!j) return Forward(j);
      auto w = OpenFours(document, weights, draco);
      if (!w) return Forward(w);
      influences_.push_back({std::move(*j), std::move(*w)});
    }
    return influences_.empty() ? Result<void>() : ReadJoints(document, scene);
  }

  bool empty() const { return targets_.empty() && normal_targets_.empty() && influences_.empty(); }

  Result<void> Apply(std::uint64_t first, std::span<double> xyz) override {
    if (auto ok = AddTargets(targets_, first, xyz); !ok) return ok;
    return Skin(first, xyz.size() / 3, [&](std::size_t i) {
      const Vec3 p = Pulled({xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]});
      xyz[3 * i] = p.x, xyz[3 * i + 1] = p.y, xyz[3 * i + 2] = p.z;
    });
  }

  Result<void> ApplyToNormals(std::uint64_t first, std::span<double> xyz) override {
    if (auto ok = AddTargets(normal_targets_, first, xyz); !ok) return ok;
    return Skin(first, xyz.size() / 3, [&](std::size_t i) {
      const Vec3 n = Blended().TurnNormal({xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]});
      xyz[3 * i] = n.x, xyz[3 * i + 1] = n.y, xyz[3 * i + 2] = n.z;
    });
  }

 private:
  // An accessor as long as the positions.
  Result<GltfValues> Vec(const GltfDocument& document, std::uint32_t accessor,
                         std::uint32_t components) {
    auto values = GltfValues::Open(buffers_, document, accessor);
    if (!values) return values;
    const auto position =
        document.meshes[draw_.mesh].primitives[draw_.primitive].attributes.at("POSITION");
    if (values->components() != components ||
        values->count() != document.accessors[position].count) {
      return Corrupt(
          buffers_, draw_,
          ": accessor " + std::to_string(accessor) + " has " + std::to_string(values->count()) +
              " elements of " + std::to_string(values->components()) +
              " components, expected as many as positions, of " + std::to_string(components));
    }
    return values;
  }

  Result<Fours> OpenFours(const GltfDocument& document, const std::string& key,
                          const DracoMesh* draco) {
    const GltfPrimitive& primitive = document.meshes[draw_.mesh].primitives[draw_.primitive];
    Fours fours;
    const auto id = draco != nullptr ? primitive.draco->ids.find(key) : primitive.attributes.end();
    if (draco != nullptr && id != primitive.draco->ids.end()) {
      auto values = draco->Values(id->second, buffers_.name() + ": " + key, 4);
      if (!values) return Forward(values);
      fours.decoded = std::move(*values);
      return fours;
    }
    auto values = Vec(document, primitive.attributes.at(key), 4);
    if (!values) return Forward(values);
    fours.stored = std::move(*values);
    return fours;
  }

  Result<void> ReadJoints(const GltfDocument& document, const GltfScene& scene) {
    const GltfSkin& skin = document.skins[*document.nodes[*draw_.posed_by].skin];
    std::optional<GltfValues> inverse;
    if (skin.inverse_bind) {
      auto values = GltfValues::Open(buffers_, document, *skin.inverse_bind);
      if (!values) return Forward(values);
      if (values->components() != 16 || values->count() < skin.joints.size()) {
        return Corrupt(buffers_, draw_, ": the skin has too few inverse bind matrices");
      }
      inverse = std::move(*values);
    }
    for (std::size_t i = 0; i < skin.joints.size(); ++i) {
      Affine joint = scene.world[skin.joints[i]];
      if (inverse) {
        std::array<double, 16> c;
        if (auto ok = inverse->Read(i, c); !ok) return ok;
        Affine bind;
        for (std::size_t row = 0; row < 3; ++row) {
          for (std::size_t column = 0; column < 4; ++column) {
            bind.m[4 * row + column] = c[4 * column + row];
          }
        }
        joint = joint * bind;
      }
      joints_.push_back(joint);
    }
    return {};
  }

  Result<void> AddTargets(std::vector<Target>& targets, std::uint64_t first,
                          std::span<double> xyz) {
    for (Target& target : targets) {
      moves_.resize(xyz.size());
      if (auto ok = target.moves.Read(first, moves_); !ok) return ok;
      for (std::size_t i = 0; i < xyz.size(); ++i) xyz[i] += target.weight * moves_[i];
    }
    return {};
  }

  // Calls move(vertex, joints with weights) for the vertices whose joints say where they are.
  template <class MoveOne>
  Result<void> Skin(std::uint64_t first, std::size_t n, MoveOne move) {
    if (influences_.empty()) return {};
    const std::size_t sets = influences_.size();
    joint_of_.resize(4 * n * sets);
    weight_of_.resize(4 * n * sets);
    for (std::size_t s = 0; s < sets; ++s) {
      const std::span<double> joints = std::span(joint_of_).subspan(4 * n * s, 4 * n);
      if (auto ok = influences_[s].joints.Read(first, joints); !ok) return ok;
      const std::span<double> weights = std::span(weight_of_).subspan(4 * n * s, 4 * n);
      if (auto ok = influences_[s].weights.Read(first, weights); !ok) return ok;
    }
    for (std::size_t i = 0; i < n; ++i) {
      pulls_.clear();
      for (std::size_t s = 0; s < sets; ++s) {
        for (std::size_t k = 4 * (n * s + i); k < 4 * (n * s + i) + 4; ++k) {
          if (weight_of_[k] == 0) continue;
          if (!(joint_of_[k] >= 0 && joint_of_[k] < static_cast<double>(joints_.size()))) {
            return NoJoint(first + i, joint_of_[k]);
          }
          pulls_.push_back({&joints_[static_cast<std::size_t>(joint_of_[k])], weight_of_[k]});
        }
      }
      if (!pulls_.empty()) move(i);
    }
    return {};
  }

  tl::unexpected<Error> NoJoint(std::uint64_t vertex, double joint) const {
    return Corrupt(buffers_, draw_,
                   ": vertex " + std::to_string(vertex) + " hangs on joint " +
                       std::to_string(joint) + " of " + std::to_string(joints_.size()));
  }

  // Weights are rounded, so that they may not add up to 1. Without any the vertex stays.
  Vec3 Pulled(Vec3 from) const {
    Vec3 to;
    double sum = 0;
    for (const auto& [joint, weight] : pulls_) {
      to = to + (*joint)(from)*weight;
      sum += weight;
    }
    if (sum == 0) return from;
    return sum == 1 ? to : Vec3{to.x / sum, to.y / sum, to.z / sum};
  }

  // The joints' matrix, up to a positive factor.
  Affine Blended() const {
    Affine blend;
    blend.m.fill(0);
    double sum = 0;
    for (const auto& [joint, weight] : pulls_) {
      for (std::size_t k = 0; k < blend.m.size(); ++k) blend.m[k] += joint->m[k] * weight;
      sum += weight;
    }
    for (double& each : blend.m) each = sum < 0 ? -each : each;
    return sum == 0 ? Affine() : blend;
  }

  GltfBuffers& buffers_;
  const GltfDraw draw_;
  std::vector<Target> targets_, normal_targets_;
  std::vector<Influence> influences_;
  std::vector<Affine> joints_;
  std::vector<double> moves_, joint_of_, weight_of_;
  std::vector<Pull> pulls_;  // On one vertex.
};

}  // namespace

Result<std::unique_ptr<GltfPose>> GltfPose::Open(GltfBuffers& buffers, const GltfDocument& document,
                                                 const GltfScene& scene, const GltfDraw& draw,
                                                 const DracoMesh* draco, bool normals) {
  auto pose = std::make_unique<Pose>(buffers, draw);
  if (auto ok = pose->OpenTargets(document, normals); !ok) return Forward(ok);
  if (auto ok = pose->OpenSkin(document, scene, draco); !ok) return Forward(ok);
  if (pose->empty()) return std::unique_ptr<GltfPose>();
  return pose;
}

}  // namespace strata::io
