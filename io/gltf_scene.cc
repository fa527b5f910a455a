#include "io/gltf_scene.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>
#include <utility>

#include "io/gltf_accessor.h"

namespace strata::io {
namespace {

constexpr std::uint32_t kNoNode = UINT32_MAX;
constexpr std::uint64_t kMostRepeats = std::uint64_t{1} << 20;

// An instance before they are put in order.
struct Placing {
  std::uint32_t mesh = 0;
  std::uint32_t posed_by = kNoNode;
  GltfInstance at;
};

bool IsSkinned(const GltfMesh& mesh) {
  return std::any_of(mesh.primitives.begin(), mesh.primitives.end(), [](const auto& primitive) {
    return primitive.attributes.contains("JOINTS_0");
  });
}

class Unroller {
 public:
  Unroller(GltfBuffers& buffers, const GltfDocument& document)
      : buffers_(buffers),
        document_(document),
        visits_left_(document.nodes.size() + kMostRepeats) {}

  Result<GltfScene> Unroll() {
    const std::size_t nodes = document_.nodes.size();
    scene_.world.resize(nodes);
    reached_.assign(nodes, false);
    on_path_.assign(nodes, false);
    const std::vector<std::uint32_t> orphans = Orphans();
    const auto& roots = document_.has_scenes ? document_.roots : orphans;
    for (const std::uint32_t root : roots) {
      if (auto ok = Visit(root, true); !ok) return Forward(ok);
    }
    if (roots.empty() && nodes > 0 && !document_.has_scenes) return Cycle(0);
    if (nodes == 0 && !document_.has_scenes) PlaceAllMeshes();
    // Joints may lie outside the scene.
    for (const std::uint32_t root : orphans) {
      if (!reached_[root]) {
        if (auto ok = Visit(root, false); !ok) return Forward(ok);
      }
    }
    return Order();
  }

 private:
  struct Step {
    std::uint32_t node;
    std::size_t next_child;
    Affine world;
  };

  tl::unexpected<Error> Cycle(std::uint32_t node) const {
    return Fail(ErrorCode::kCorruptInput, buffers_.name() + ": /nodes/" + std::to_string(node) +
                                              ": is its own descendant; expected a tree");
  }

  std::vector<std::uint32_t> Orphans() const {
    std::vector<bool> has_parent(document_.nodes.size());
    for (const GltfNode& node : document_.nodes) {
      for (const std::uint32_t child : node.children) has_parent[child] = true;
    }
    std::vector<std::uint32_t> orphans;
    for (std::uint32_t i = 0; i < has_parent.size(); ++i) {
      if (!has_parent[i]) orphans.push_back(i);
    }
    return orphans;
  }

  Result<void> Visit(std::uint32_t root, bool place) {
    std::vector<Step> path;
    if (auto ok = Enter(root, Affine(), place, path); !ok) return ok;
    while (!path.empty()) {
      Step& step = path.back();
      const GltfNode& node = document_.nodes[step.node];
      if (step.next_child == node.children.size()) {
        on_path_[step.node] = false;
        path.pop_back();
        continue;
      }
      const std::uint32_t child = node.children[step.next_child++];
      const Affine world = step.world;
      if (auto ok = Enter(child, world, place, path); !ok) return ok;
    }
    return {};
  }

  Result<void> Enter(std::uint32_t index, const Affine& parent, bool place,
                     std::vector<Step>& path) {
    if (on_path_[index]) return Cycle(index);
    if (visits_left_-- == 0) {
      return Fail(ErrorCode::kOverBudget, buffers_.name() + ": /nodes: nodes that have several " +
                                              "parents come to more than " +
                                              std::to_string(kMostRepeats) + " placings");
    }
    const GltfNode& node = document_.nodes[index];
    const Affine world = parent.is_identity()       ? node.local
                         : node.local.is_identity() ? parent
                                                    : parent * node.local;
    if (!reached_[index]) scene_.world[index] = world;
    reached_[index] = on_path_[index] = true;
    path.push_back({index, 0, world});
    return place && node.mesh ? Place(index, world) : Result<void>();
  }

  Result<void> Place(std::uint32_t index, const Affine& world) {
    const GltfNode& node = document_.nodes[index];
    const bool posed = node.skin.has_value() || !node.weights.empty();
    Placing placing{*node.mesh, posed ? index : kNoNode, {world, index, 0}};
    // A skin's joints say where its mesh is; the node's own place has no meaning.
    if (node.skin && IsSkinned(document_.meshes[*node.mesh])) placing.at.transform = Affine();
    if (node.instancing.empty()) {
      placings_.push_back(placing);
      return TakeMemory();
    }
    return PlaceInstances(node, placing);
  }

  Result<void> TakeMemory() {
    if (buffers_.memory() == nullptr || placings_.size() < paid_) return {};
    const std::uint64_t want = std::max<std::uint64_t>(2 * paid_, 1024);
    auto share =
        buffers_.memory()->Take((want - paid_) * (2 * sizeof(Placing) + sizeof(GltfInstance)),
                                buffers_.name() + ": the places of meshes");
    if (!share) return Forward(share);
    shares_.push_back(std::move(*share));
    paid_ = want;
    return {};
  }

  // EXT_mesh_gpu_instancing: the node's place, then each instance's own.
  Result<void> PlaceInstances(const GltfNode& node, Placing placing) {
    std::optional<GltfValues> translation, rotation, scale;
    std::optional<std::uint64_t> count;
    for (const auto& [key, accessor] : node.instancing) {
      const bool is_t = key == "TRANSLATION", is_r = key == "ROTATION", is_s = key == "SCALE";
      auto values = GltfValues::Open(buffers_, document_, accessor);
      if (!values) return Forward(values);
      const std::uint32_t expected = is_r ? 4 : 3;
      if ((count && *count != values->count()) ||
          ((is_t || is_r || is_s) && values->components() != expected)) {
        return Fail(ErrorCode::kCorruptInput,
                    buffers_.name() + ": /nodes/" + std::to_string(placing.at.node) +
                        "/extensions/EXT_mesh_gpu_instancing: " + key.substr(0, 40) +
                        " has another shape or count than expected");
      }
      count = values->count();
      if (is_t)
        translation = std::move(*values);
      else if (is_r)
        rotation = std::move(*values);
      else if (is_s)
        scale = std::move(*values);
    }
    for (std::uint64_t i = 0; i < *count; ++i) {
      auto local = InstanceAt(i, translation, rotation, scale);
      if (!local) return Forward(local);
      Placing one = placing;
      one.at.transform = placing.at.transform * *local;
      one.at.instance = static_cast<std::uint32_t>(i);
      placings_.push_back(one);
      if (auto ok = TakeMemory(); !ok) return ok;
    }
    return {};
  }

  static Result<Affine> InstanceAt(std::uint64_t i, std::optional<GltfValues>& translation,
                                   std::optional<GltfValues>& rotation,
                                   std::optional<GltfValues>& scale) {
    std::array<double, 3> t{0, 0, 0}, s{1, 1, 1};
    std::array<double, 4> r{0, 0, 0, 1};
    if (translation) {
      if (auto ok = translation->Read(i, t); !ok) return Forward(ok);
    }
    if (rotation) {
      if (auto ok = rotation->Read(i, r); !ok) return Forward(ok);
    }
    if (scale) {
      if (auto ok = scale->Read(i, s); !ok) return Forward(ok);
    }
    return Affine::FromTrs({t[0], t[1], t[2]}, r, {s[0], s[1], s[2]});
  }

  void PlaceAllMeshes() {
    for (std::uint32_t mesh = 0; mesh < document_.meshes.size(); ++mesh) {
      placings_.push_back({mesh, kNoNode, {Affine(), kNoNode, 0}});
    }
  }

  Result<GltfScene> Order() {
    std::stable_sort(placings_.begin(), placings_.end(), [](const Placing& a, const Placing& b) {
      return std::tie(a.mesh, a.posed_by) < std::tie(b.mesh, b.posed_by);
    });
    for (std::size_t begin = 0, end = 0; begin < placings_.size(); begin = end) {
      const Placing& first = placings_[begin];
      for (end = begin; end < placings_.size() && placings_[end].mesh == first.mesh &&
                        placings_[end].posed_by == first.posed_by;
           ++end) {
        scene_.instances.push_back(placings_[end].at);
      }
      AddDraws(first, begin, end - begin);
    }
    std::stable_sort(scene_.draws.begin(), scene_.draws.end(),
                     [](const GltfDraw& a, const GltfDraw& b) {
                       return std::tie(a.mesh, a.primitive) < std::tie(b.mesh, b.primitive);
                     });
    if (buffers_.memory() != nullptr) {
      shares_.clear();
      auto share = buffers_.memory()->Take(scene_.instances.size() * sizeof(GltfInstance),
                                           buffers_.name() + ": the places of meshes");
      if (!share) return Forward(share);
      scene_.share = std::move(*share);
    }
    return std::move(scene_);
  }

  void AddDraws(const Placing& first, std::size_t begin, std::size_t count) {
    const auto posed = first.posed_by == kNoNode ? std::nullopt : std::optional(first.posed_by);
    const auto primitives = document_.meshes[first.mesh].primitives.size();
    for (std::uint32_t p = 0; p < primitives; ++p) {
      scene_.draws.push_back({first.mesh, p, posed, begin, count});
    }
  }

  GltfBuffers& buffers_;
  const GltfDocument& document_;
  std::uint64_t visits_left_, paid_ = 0;
  std::vector<bool> reached_, on_path_;
  std::vector<Placing> placings_;
  std::vector<MemoryShare> shares_;
  GltfScene scene_;
};

}  // namespace

Result<GltfScene> UnrollGltf(GltfBuffers& buffers, const GltfDocument& document) {
  return Unroller(buffers, document).Unroll();
}

}  // namespace strata::io
