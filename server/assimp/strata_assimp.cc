// strata-assimp MEMORY SUFFIX surface|attributes: reads the mesh on descriptor 3 with assimp and
// writes its polygons, placed in the world, with or without what their corners carry, to standard
// output as io/assimp_stream.h says.
//
// A program of its own because assimp's parsers have a history of memory errors: it may allocate
// MEMORY bytes, use a bounded time, and do nothing with the system but read and write what it has
// open. What happens to it is the caller's to notice.
#include <assimp/importerdesc.h>
#include <assimp/material.h>
#include <assimp/mesh.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <assimp/Importer.hpp>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <new>
#include <string>
#include <vector>

#include "io/affine.h"
#include "io/assimp_stream.h"

namespace {

using strata::io::Affine;
using strata::io::AssimpRecord;
using strata::io::kAssimpInput;

constexpr int kMostDepth = 512;
constexpr std::uint64_t kMostPlacings = std::uint64_t{1} << 20;
constexpr rlim_t kMostSeconds = 600;

// Numbers and texts to standard output. A reader that is gone ends the program.
class Output {
 public:
  ~Output() { Flush(); }
  void Put(const void* bytes, std::size_t n) {
    buffer_.append(static_cast<const char*>(bytes), n);
    if (buffer_.size() >= kFull) Flush();
  }
  template <class T>
  void Number(T value) {
    Put(&value, sizeof(value));
  }
  void Record(AssimpRecord record) { Number(static_cast<std::uint32_t>(record)); }
  void Text(std::string text) {
    text.resize(std::min<std::size_t>(text.size(), strata::io::kMostAssimpText));
    Number(static_cast<std::uint32_t>(text.size()));
    Put(text.data(), text.size());
  }
  void Flush() {
    for (std::size_t at = 0; at < buffer_.size();) {
      const ssize_t n = write(STDOUT_FILENO, buffer_.data() + at, buffer_.size() - at);
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) _exit(1);
      at += static_cast<std::size_t>(n);
    }
    buffer_.clear();
  }

 private:
  static constexpr std::size_t kFull = std::size_t{1} << 18;
  std::string buffer_;
};

[[noreturn]] void FailWith(std::uint32_t code, const std::string& why) {
  Output out;
  out.Record(AssimpRecord::kFailure);
  out.Number(code);
  out.Text(why);
  out.Flush();
  _exit(0);
}

void Limit(int resource, rlim_t value) {
  const struct rlimit limit { value, value };
  if (setrlimit(static_cast<__rlimit_resource_t>(resource), &limit) != 0) {
    FailWith(0, "cannot limit itself");
  }
}

// From here on only memory and open descriptors: everything else is refused by the kernel.
void Confine() {
  constexpr int kAllowed[] = {SYS_read,           SYS_write,        SYS_mmap,
                              SYS_munmap,         SYS_mremap,       SYS_mprotect,
                              SYS_madvise,        SYS_brk,          SYS_futex,
                              SYS_exit,           SYS_exit_group,   SYS_rt_sigaction,
                              SYS_rt_sigprocmask, SYS_rt_sigreturn, SYS_clock_gettime,
                              SYS_getrandom,      SYS_sched_yield,  SYS_gettid,
                              SYS_getpid,         SYS_tgkill,       SYS_close};
  std::vector<sock_filter> filter;
  filter.push_back(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)));
  for (const int number : kAllowed) {
    filter.push_back(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, static_cast<unsigned>(number), 0, 1));
    filter.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
  }
  filter.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EPERM));
  const sock_fprog program{static_cast<unsigned short>(filter.size()), filter.data()};
  // A kernel without seccomp leaves the limits alone: better than not reading at all.
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0) {
    prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program, 0, 0);
  }
}

std::string ReadInput() {
  struct stat status {};
  if (fstat(kAssimpInput, &status) != 0) FailWith(0, "found no input");
  std::string bytes(static_cast<std::size_t>(status.st_size), '\0');
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t n =
        pread(kAssimpInput, bytes.data() + at, bytes.size() - at, static_cast<off_t>(at));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) FailWith(0, "reading failed");
    at += static_cast<std::size_t>(n);
  }
  return bytes;
}

struct Placed {
  unsigned mesh;
  std::uint32_t node;  // Among those that place a mesh.
  Affine transform;
};

// All placings, and the nodes that make them.
struct Scene {
  std::vector<Placed> placed;
  std::vector<const aiNode*> nodes;
};

// Every mesh of every node. assimp makes a tree of its own, so that it has no cycles.
void Place(const aiNode& node, const Affine& parent, int depth, Scene& scene) {
  if (depth > kMostDepth) FailWith(0, "nodes are nested too deeply");
  const aiMatrix4x4& m = node.mTransformation;
  Affine world;
  world.m = {m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4};
  world = parent * world;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    if (scene.placed.size() == kMostPlacings) FailWith(1, "more than 2^20 placings of meshes");
    const auto number = static_cast<std::uint32_t>(scene.nodes.size());
    scene.placed.push_back({node.mMeshes[i], number, world});
  }
  if (node.mNumMeshes > 0) scene.nodes.push_back(&node);
  for (unsigned i = 0; i < node.mNumChildren; ++i) {
    Place(*node.mChildren[i], world, depth + 1, scene);
  }
}

std::string UpAxis(const aiScene& scene) {
  int axis = -1;
  if (scene.mMetaData == nullptr || !scene.mMetaData->Get("UpAxis", axis)) return "";
  constexpr const char* kNames[] = {"x", "y", "z"};
  return axis >= 0 && axis < 3 ? kNames[axis] : "";
}

// What corners carry, in all meshes together.
struct Carried {
  bool normals = false;
  unsigned colors = 0, uvs = 0;  // Sets.

  explicit Carried(const aiScene& scene) {
    static_assert(AI_MAX_NUMBER_OF_COLOR_SETS <= strata::io::kMostAssimpSets &&
                  AI_MAX_NUMBER_OF_TEXTURECOORDS <= strata::io::kMostAssimpSets);
    for (unsigned i = 0; i < scene.mNumMeshes; ++i) {
      const aiMesh& mesh = *scene.mMeshes[i];
      normals = normals || mesh.mNormals != nullptr;
      for (unsigned k = 0; k < AI_MAX_NUMBER_OF_COLOR_SETS; ++k) {
        if (mesh.mColors[k] != nullptr) colors = std::max(colors, k + 1);
      }
      for (unsigned k = 0; k < AI_MAX_NUMBER_OF_TEXTURECOORDS; ++k) {
        if (mesh.mTextureCoords[k] != nullptr) uvs = std::max(uvs, k + 1);
      }
    }
  }
};

// A list of `count` names, of which name(i) gives the i-th.
template <class Name>
void WriteNames(std::size_t count, Output& out, Name name) {
  if (count > strata::io::kMostAssimpNames) FailWith(1, "more than 2^20 names");
  out.Number(static_cast<std::uint32_t>(count));
  for (std::size_t i = 0; i < count; ++i) out.Text(name(i));
}

void WriteHead(const aiScene& scene, const Scene& unrolled, const Carried& carried,
               const std::string& format, Output& out) {
  std::uint64_t vertices = 0, points = 0, lines = 0;
  for (unsigned i = 0; i < scene.mNumMeshes; ++i) {
    const aiMesh& mesh = *scene.mMeshes[i];
    vertices += mesh.mNumVertices;
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
      points += mesh.mFaces[f].mNumIndices == 1 ? 1 : 0;
      lines += mesh.mFaces[f].mNumIndices == 2 ? 1 : 0;
    }
  }
  out.Record(AssimpRecord::kHead);
  for (const std::uint64_t count : {vertices, std::uint64_t{scene.mNumMeshes},
                                    std::uint64_t{unrolled.placed.size()}, points, lines}) {
    out.Number(count);
  }
  out.Text(format);
  WriteNames(scene.mNumMaterials, out,
             [&](std::size_t i) -> std::string { return scene.mMaterials[i]->GetName().C_Str(); });
  out.Text(UpAxis(scene));
  for (const unsigned number : {carried.normals ? 1u : 0u, carried.colors, carried.uvs}) {
    out.Number(std::uint32_t{number});
  }
  WriteNames(scene.mNumMeshes, out,
             [&](std::size_t i) -> std::string { return scene.mMeshes[i]->mName.C_Str(); });
  WriteNames(unrolled.nodes.size(), out,
             [&](std::size_t i) -> std::string { return unrolled.nodes[i]->mName.C_Str(); });
}

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

template <std::size_t N>
void WriteFloats(const std::array<float, N>& values, Output& out) {
  out.Put(values.data(), sizeof values);
}

// What vertex `index` carries.
void WriteValues(const aiMesh& mesh, unsigned index, const Affine& transform,
                 const Carried& carried, Output& out) {
  if (carried.normals) {
    std::array<float, 3> normal = {kNone, kNone, kNone};
    if (mesh.mNormals != nullptr) {
      const aiVector3D& n = mesh.mNormals[index];
      const strata::Vec3 turned = transform.TurnNormal({n.x, n.y, n.z});
      for (int k = 0; k < 3; ++k)
        normal[static_cast<std::size_t>(k)] = static_cast<float>(turned[k]);
    }
    WriteFloats(normal, out);
  }
  for (unsigned k = 0; k < carried.colors; ++k) {
    std::array<float, 4> color = {1, 1, 1, 1};
    if (const aiColor4D* const set = mesh.mColors[k]) {
      color = {set[index].r, set[index].g, set[index].b, set[index].a};
    }
    WriteFloats(color, out);
  }
  for (unsigned k = 0; k < carried.uvs; ++k) {
    std::array<float, 2> uv = {kNone, kNone};
    if (const aiVector3D* const set = mesh.mTextureCoords[k]) uv = {set[index].x, set[index].y};
    WriteFloats(uv, out);
  }
}

// Of a placing; with values if `carried` is given.
void WritePolygons(const aiMesh& mesh, const Placed& placed, const Carried* carried, Output& out) {
  const Affine& transform = placed.transform;
  const bool still = transform.is_identity(), mirrored = transform.Determinant() < 0;
  out.Record(AssimpRecord::kPlaced);
  for (const std::uint32_t id :
       {std::uint32_t{placed.mesh}, placed.node, std::uint32_t{mesh.mMaterialIndex}}) {
    out.Number(id);
  }
  for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
    const aiFace& face = mesh.mFaces[f];
    const unsigned n = face.mNumIndices;
    if (n == 1 || n == 2) continue;
    if (n > strata::io::kMostAssimpCorners) {
      out.Record(AssimpRecord::kFailure);
      out.Number(std::uint32_t{1});
      out.Text("a polygon of more than 2^20 corners");
      out.Flush();
      _exit(0);
    }
    // Mirrored, the corners go round the other way.
    const auto index = [&](unsigned k) { return face.mIndices[mirrored ? n - 1 - k : k]; };
    out.Record(AssimpRecord::kPolygon);
    out.Number(std::uint32_t{n});
    for (unsigned k = 0; k < n; ++k) {
      if (index(k) >= mesh.mNumVertices) _exit(3);
      const aiVector3D& v = mesh.mVertices[index(k)];
      const strata::Vec3 at{v.x, v.y, v.z};
      out.Number(still ? at : transform(at));
    }
    for (unsigned k = 0; carried != nullptr && k < n; ++k) {
      WriteValues(mesh, index(k), transform, *carried, out);
    }
  }
}

void Convert(const std::string& bytes, const std::string& suffix, bool attributes) {
  Assimp::Importer importer;
  const aiScene* const scene =
      importer.ReadFileFromMemory(bytes.data(), bytes.size(), 0, suffix.c_str());
  if (scene == nullptr) {
    const std::string why = importer.GetErrorString();
    const bool unknown = why.find("No suitable reader") != why.npos;
    return FailWith(unknown ? 2 : 0, why);
  }
  const aiImporterDesc* const about = importer.GetImporterInfo(
      static_cast<std::size_t>(importer.GetPropertyInteger("importerIndex", -1)));
  Scene unrolled;
  if (scene->mRootNode != nullptr) Place(*scene->mRootNode, {}, 0, unrolled);
  const Carried carried(*scene);
  Output out;
  WriteHead(*scene, unrolled, carried, about == nullptr ? "" : about->mName, out);
  for (const Placed& each : unrolled.placed) {
    WritePolygons(*scene->mMeshes[each.mesh], each, attributes ? &carried : nullptr, out);
  }
  out.Record(AssimpRecord::kEnd);
  out.Flush();
}

}  // namespace

int main(int argc, char** argv) {
  const std::string run = argc == 4 ? argv[3] : "";
  const bool attributes = run == strata::io::kAssimpAttributes;
  if (!attributes && run != strata::io::kAssimpSurface) return 2;
  // The libraries are mapped already, and count.
  constexpr rlim_t kOwn = rlim_t{256} << 20;
  Limit(RLIMIT_AS, static_cast<rlim_t>(std::strtoull(argv[1], nullptr, 10)) + kOwn);
  Limit(RLIMIT_CPU, kMostSeconds);
  Limit(RLIMIT_CORE, 0);
  Limit(RLIMIT_FSIZE, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  try {
    const std::string bytes = ReadInput();
    Confine();
    Convert(bytes, argv[2], attributes);
  } catch (const std::bad_alloc&) {
    FailWith(1, "out of memory");
  } catch (const std::exception& e) {
    FailWith(0, e.what());
  }
  _exit(0);
}
