// Vertices that exceed their memory budget: a window while that works, a join when it does not.
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <optional>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/open_mesh.h"
#include "io/vertex_file.h"
#include "io/vertex_join.h"
#include "io/vertex_window.h"

namespace strata::io {

/// Looks up the vertices of a mesh on disk within a budget (docs/adr/0008).
///
/// Coherent indices go through a VertexWindow. Once that has loaded much more than the triangles
/// are worth, the reader is asked to look ahead (WantsLookAhead, LookAhead): it reads a segment of
/// the mesh only to Record its indices, the VertexJoin resolves them, the reader goes back, and At
/// takes the answers in the same order. Where a segment ends, or the window may have had enough,
/// the reader must stop and ask again (AtBorder).
///
/// Failures are kept: once failed(), what At returned is of no use. Threads: one at a time.
class FarVertices {
 public:
  /// Errors: kOverBudget (saying how many bytes are needed). `options` names budget, scratch space
  /// and context; `name` is the input's.
  static Result<std::unique_ptr<FarVertices>> Open(std::unique_ptr<VertexFile> file,
                                                   std::uint64_t budget, const OpenOptions& options,
                                                   const std::string& name);

  std::uint64_t size() const { return file_->size(); }

  /// The vertex's position. Precondition: index < size(), not while recording.
  Vec3 At(std::uint64_t index) {
    const char* const vertex = mode_ == Mode::kWindow ? window_->Find(index) : join_->Next(index);
    return file_is_double_ ? Load<double>(vertex) : Load<float>(vertex);
  }
  /// Calls f(fetch), where fetch(index) is At without its tests.
  template <class F>
  auto WithFetch(F&& f) {
    if (mode_ == Mode::kWindow) {
      if (file_is_double_) return f([&](auto i) { return Load<double>(window_->Find(i)); });
      return f([&](auto i) { return Load<float>(window_->Find(i)); });
    }
    if (file_is_double_) return f([&](auto i) { return Load<double>(join_->Next(i)); });
    return f([&](auto i) { return Load<float>(join_->Next(i)); });
  }
  /// Only within LookAhead, for each index that will be asked for, in the order of asking.
  void Record(std::uint64_t index) { join_->Record(index); }

  /// True if reading must stop here: to ask WantsLookAhead, or to return from `go_on`.
  bool AtBorder() const { return *progress_ >= border_; }
  /// How many triangles may be looked up or recorded before AtBorder must be asked again.
  std::uint64_t Room() const;

  /// To be asked before a batch and at a border, with the number of triangles since the last
  /// Rewind.
  bool WantsLookAhead(std::uint64_t triangles);
  /// `go_on` reads on, recording, until AtBorder or the mesh's end, and says whether it was the
  /// end; `go_back` returns to where reading stood. Errors: kIo, kCancelled, kOverBudget, and those
  /// of `go_back`; what stopped `go_on` will stop the reader again in its place.
  Result<void> LookAhead(const std::function<Result<bool>()>& go_on,
                         const std::function<Result<void>()>& go_back);
  /// The reader starts over. What had to be joined once is joined at once from now on.
  void Rewind();

  Result<bool> Visit(const std::function<void(const VertexView&)>& visit);

  bool failed() const { return (window_ && window_->failed()) || (join_ && join_->failed()); }
  tl::unexpected<Error> failure() const {
    return window_ && window_->failed() ? window_->failure() : join_->failure();
  }

  /// For tests and measurements.
  std::uint64_t window_faults() const { return faults_ + (window_ ? window_->faults() : 0); }
  std::uint64_t segments() const { return segments_; }

 private:
  enum class Mode : std::uint8_t { kWindow, kRecord, kReplay };

  FarVertices(std::unique_ptr<VertexFile> file, std::uint64_t budget, const OpenOptions& options);

  template <class T>
  static Vec3 Load(const char* vertex) {
    T xyz[3];
    std::memcpy(xyz, vertex, sizeof(xyz));
    return {xyz[0], xyz[1], xyz[2]};
  }
  bool MayJoin() const;
  bool Thrashes(std::uint64_t triangles);
  Result<bool> Record(const std::function<Result<bool>()>& go_on);

  std::unique_ptr<VertexFile> file_;
  const bool file_is_double_;
  std::uint64_t budget_;
  ScratchFolder* scratch_;
  const RunContext* context_;

  Mode mode_ = Mode::kWindow;
  std::unique_ptr<VertexWindow> window_;
  std::unique_ptr<VertexJoin> join_;
  const std::uint64_t* progress_;  // What counts towards the border.
  std::uint64_t border_ = 0;

  std::uint64_t debt_ = 0, faults_seen_ = 0, triangles_seen_ = 0;  // See Thrashes.
  std::uint64_t faults_ = 0, segments_ = 0;
};

}  // namespace strata::io
