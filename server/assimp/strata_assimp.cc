// strata-assimp MEMORY SUFFIX: reads the mesh on descriptor 3 with assimp and writes its polygons,
// placed in the world, to standard output as io/assimp_stream.h says.
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

#include <assimp/Importer.hpp>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>
#include <string>
#include <vector>

#include "io/assimp_stream.h"

namespace {

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
    constexpr std::size_t kMost = 4096;
    text.resize(std::min(text.size(), kMost));
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
  const aiMesh* mesh;
  aiMatrix4x4t<double> transform;
};

// Every mesh of every node. assimp makes a tree of its own, so that it has no cycles.
void Place(const aiScene& scene, const aiNode& node, const aiMatrix4x4t<double>& parent, int depth,
           std::vector<Placed>& placed) {
  if (depth > kMostDepth) FailWith(0, "nodes are nested too deeply");
  const aiMatrix4x4& m = node.mTransformation;
  const aiMatrix4x4t<double> local(m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3,
                                   m.c4, m.d1, m.d2, m.d3, m.d4);
  const aiMatrix4x4t<double> world = parent * local;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    if (placed.size() == kMostPlacings) FailWith(1, "more than 2^20 placings of meshes");
    placed.push_back({scene.mMeshes[node.mMeshes[i]], world});
  }
  for (unsigned i = 0; i < node.mNumChildren; ++i) {
    Place(scene, *node.mChildren[i], world, depth + 1, placed);
  }
}

std::string UpAxis(const aiScene& scene) {
  int axis = -1;
  if (scene.mMetaData == nullptr || !scene.mMetaData->Get("UpAxis", axis)) return "";
  constexpr const char* kNames[] = {"x", "y", "z"};
  return axis >= 0 && axis < 3 ? kNames[axis] : "";
}

void WriteHead(const aiScene& scene, const std::vector<Placed>& placed, const std::string& format,
               Output& out) {
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
  for (const std::uint64_t count :
       {vertices, std::uint64_t{scene.mNumMeshes}, std::uint64_t{placed.size()}, points, lines}) {
    out.Number(count);
  }
  out.Text(format);
  out.Number(static_cast<std::uint32_t>(scene.mNumMaterials));
  for (unsigned i = 0; i < scene.mNumMaterials; ++i) {
    out.Text(scene.mMaterials[i]->GetName().C_Str());
  }
  out.Text(UpAxis(scene));
}

void WritePolygons(const Placed& placed, Output& out) {
  const aiMesh& mesh = *placed.mesh;
  const aiMatrix4x4t<double>& m = placed.transform;
  const bool still = m == aiMatrix4x4t<double>();
  const double turn = m.a1 * (m.b2 * m.c3 - m.b3 * m.c2) - m.a2 * (m.b1 * m.c3 - m.b3 * m.c1) +
                      m.a3 * (m.b1 * m.c2 - m.b2 * m.c1);
  for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
    const aiFace& face = mesh.mFaces[f];
    const unsigned n = face.mNumIndices;
    if (n == 1 || n == 2 || n > strata::io::kMostAssimpCorners) continue;
    out.Record(AssimpRecord::kPolygon);
    out.Number(static_cast<std::uint32_t>(n));
    for (unsigned k = 0; k < n; ++k) {
      // Mirrored, the corners go round the other way.
      const unsigned index = face.mIndices[turn < 0 ? n - 1 - k : k];
      if (index >= mesh.mNumVertices) _exit(3);
      const aiVector3D& v = mesh.mVertices[index];
      const double x = v.x, y = v.y, z = v.z;
      out.Number(still ? x : m.a1 * x + m.a2 * y + m.a3 * z + m.a4);
      out.Number(still ? y : m.b1 * x + m.b2 * y + m.b3 * z + m.b4);
      out.Number(still ? z : m.c1 * x + m.c2 * y + m.c3 * z + m.c4);
    }
  }
}

void Convert(const std::string& bytes, const std::string& suffix) {
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
  std::vector<Placed> placed;
  if (scene->mRootNode != nullptr) Place(*scene, *scene->mRootNode, {}, 0, placed);
  Output out;
  WriteHead(*scene, placed, about == nullptr ? "" : about->mName, out);
  for (const Placed& each : placed) WritePolygons(each, out);
  out.Record(AssimpRecord::kEnd);
  out.Flush();
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
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
    Convert(bytes, argv[2]);
  } catch (const std::bad_alloc&) {
    FailWith(1, "out of memory");
  } catch (const std::exception& e) {
    FailWith(0, e.what());
  }
  _exit(0);
}
