#include "io/assimp_reader.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "io/assimp_stream.h"
#include "io/detect_format.h"
#include "io/fd.h"
#include "io/triangulate.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

constexpr std::uint64_t kMostMemory = std::uint64_t{8} << 30;
constexpr int kPollMs = 100;

// A child and the pipe from it; killed when it goes.
class AssimpChild {
 public:
  AssimpChild(std::string name, const RunContext* context)
      : name_(std::move(name)), context_(context), buffer_(std::size_t{1} << 18) {}
  ~AssimpChild() {
    if (id_ <= 0) return;
    kill(id_, SIGKILL);
    Reap();
  }
  AssimpChild(const AssimpChild&) = delete;
  AssimpChild& operator=(const AssimpChild&) = delete;

  Result<void> Start(const std::string& program, int input, std::uint64_t memory,
                     const std::string& hint) {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return System("pipe");
    pipe_ = Fd(ends[0]);
    const Fd out(ends[1]);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
    // By way of high numbers, so that neither overwrites the other.
    posix_spawn_file_actions_adddup2(&actions, input, 101);
    posix_spawn_file_actions_adddup2(&actions, out.get(), 102);
    posix_spawn_file_actions_adddup2(&actions, 102, 1);
    posix_spawn_file_actions_adddup2(&actions, 101, kAssimpInput);
    posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
    posix_spawn_file_actions_addclosefrom_np(&actions, kAssimpInput + 1);
    std::string limit = std::to_string(memory), suffix = hint, self = program;
    char* const arguments[] = {self.data(), limit.data(), suffix.data(), nullptr};
    char* const environment[] = {nullptr};
    const int failed =
        posix_spawn(&id_, program.c_str(), &actions, nullptr, arguments, environment);
    posix_spawn_file_actions_destroy(&actions);
    if (failed == 0) return {};
    id_ = -1;
    return Fail(ErrorCode::kNotFound, name_ + ": cannot start " + program + ": " +
                                          std::generic_category().message(failed));
  }

  // Exactly out.size() bytes.
  Result<void> Take(std::span<char> out) {
    while (!out.empty()) {
      if (begin_ == end_) {
        if (auto ok = Fill(); !ok) return ok;
      }
      const std::size_t n = std::min(out.size(), end_ - begin_);
      std::memcpy(out.data(), buffer_.data() + begin_, n);
      begin_ += n;
      out = out.subspan(n);
    }
    return {};
  }
  template <class T>
  Result<T> Number() {
    std::array<char, sizeof(T)> bytes;
    if (auto ok = Take(bytes); !ok) return Forward(ok);
    T value;
    std::memcpy(&value, bytes.data(), sizeof(T));
    return value;
  }
  Result<std::string> Text() {
    constexpr std::uint32_t kMost = 1 << 16;
    const auto length = Number<std::uint32_t>();
    if (!length) return Forward(length);
    if (*length > kMost) return Nonsense();
    std::string text(*length, '\0');
    if (auto ok = Take(text); !ok) return Forward(ok);
    return text;
  }
  tl::unexpected<Error> Nonsense() const {
    return Fail(ErrorCode::kCorruptInput,
                name_ + ": the process that reads it sent what cannot be understood");
  }

 private:
  tl::unexpected<Error> System(const char* what) const {
    return Fail(ErrorCode::kIo,
                name_ + ": " + what + ": " + std::generic_category().message(errno));
  }

  int Reap() {
    int status = 0;
    while (waitpid(id_, &status, 0) < 0 && errno == EINTR) {
    }
    id_ = -1;
    return status;
  }

  Result<void> Fill() {
    for (;;) {
      if (context_ != nullptr && context_->cancelled()) return Cancelled();
      struct pollfd wait {
        pipe_.get(), POLLIN, 0
      };
      const int ready = poll(&wait, 1, kPollMs);
      if (ready < 0 && errno != EINTR) return System("waiting for the process that reads it");
      if (ready <= 0) continue;
      const ssize_t n = read(pipe_.get(), buffer_.data(), buffer_.size());
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return System("reading from the process that reads it");
      if (n == 0) return Died();
      begin_ = 0;
      end_ = static_cast<std::size_t>(n);
      return {};
    }
  }

  tl::unexpected<Error> Died() {
    const int status = id_ > 0 ? Reap() : 0;
    std::string how = "ended too early, with status " + std::to_string(WEXITSTATUS(status));
    if (WIFSIGNALED(status)) {
      const int signal = WTERMSIG(status);
      how = signal == SIGXCPU ? "needed more processor time than it may"
                              : std::string("was killed by signal ") + std::to_string(signal) +
                                    " (" + strsignal(signal) + ")";
    }
    return Fail(ErrorCode::kCorruptInput,
                name_ + ": the process that reads it " + how + ": assimp does not stand this file");
  }

  std::string name_;
  const RunContext* context_;
  Fd pipe_;
  pid_t id_ = -1;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
};

class AssimpReader : public MeshReader {
 public:
  AssimpReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)), options_(options) {
    info_ = {"assimp", "converted", source_->compression()};
  }

  Result<void> Load() {
    if (auto ok = Copy(); !ok) return ok;
    memory_ = kMostMemory;
    if (options_.memory != nullptr && options_.memory->limited()) {
      memory_ = std::min(memory_, options_.memory->left() / 2);
      auto share = options_.memory->Take(memory_, source_->name() + ": the process that reads it");
      if (!share) return Forward(share);
      share_ = std::move(*share);
    }
    return Rewind();
  }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return {}; }
  const ReadCounts& counts() const override { return counts_; }
  std::uint64_t bytes_read() const override {
    return ended_ ? source_->stored_size().value_or(0) : 0;
  }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    batch.Clear();
    for (Drain(batch); !batch.full() && !ended_; Drain(batch)) {
      const auto record = child_->Number<std::uint32_t>();
      if (!record) return Forward(record);
      if (*record == static_cast<std::uint32_t>(AssimpRecord::kEnd)) {
        ended_ = true;
      } else if (*record == static_cast<std::uint32_t>(AssimpRecord::kPolygon)) {
        if (auto ok = Polygon(); !ok) return Forward(ok);
      } else {
        return child_->Nonsense();
      }
    }
    return batch.size();
  }

  Result<void> Rewind() override {
    pieces_.clear();
    next_piece_ = 0;
    counts_.faces = counts_.triangles = 0;
    counts_.skipped = {};
    ended_ = false;
    child_.reset();
    child_ = std::make_unique<AssimpChild>(source_->name(), options_.context);
    const std::string suffix = MeshSuffix(source_->name());
    auto started = child_->Start(options_.assimp, copy_->descriptor(), memory_, suffix);
    return started ? Head() : started;
  }

 private:
  // The child is given a file of its own, whatever the source is.
  Result<void> Copy() {
    auto file = NewScratchFile(options_.scratch);
    if (!file) return Forward(file);
    copy_ = std::move(*file);
    std::vector<char> buffer(std::size_t{1} << 18);
    for (;;) {
      const auto n = source_->Read(buffer);
      if (!n) return Forward(n);
      if (*n == 0) return {};
      if (auto ok = copy_->Append({buffer.data(), *n}); !ok) return ok;
    }
  }

  Result<void> Head() {
    const auto record = child_->Number<std::uint32_t>();
    if (!record) return Forward(record);
    if (*record == static_cast<std::uint32_t>(AssimpRecord::kFailure)) return Failure();
    if (*record != static_cast<std::uint32_t>(AssimpRecord::kHead)) return child_->Nonsense();
    std::array<std::uint64_t, 5> counts{};
    for (std::uint64_t& count : counts) {
      const auto number = child_->Number<std::uint64_t>();
      if (!number) return Forward(number);
      count = *number;
    }
    MeshContents contents;
    counts_.vertices = counts[0];
    contents.meshes = counts[1];
    contents.instances = counts[2];
    if (counts[3] > 0) contents.passed_over.emplace_back("points", counts[3]);
    if (counts[4] > 0) contents.passed_over.emplace_back("lines", counts[4]);
    auto format = child_->Text();
    if (!format) return Forward(format);
    info_.format = "assimp:" + *format;
    const auto materials = child_->Number<std::uint32_t>();
    if (!materials) return Forward(materials);
    for (std::uint32_t i = 0; i < *materials; ++i) {
      auto material = child_->Text();
      if (!material) return Forward(material);
      contents.materials.push_back(std::move(*material));
    }
    auto up = child_->Text();
    if (!up) return Forward(up);
    contents.up_axis = std::move(*up);
    info_.contents = std::move(contents);
    return {};
  }

  tl::unexpected<Error> Failure() {
    const auto code = child_->Number<std::uint32_t>();
    if (!code) return Forward(code);
    auto text = child_->Text();
    if (!text) return Forward(text);
    for (char& c : *text) c = c >= ' ' && c <= '~' ? c : ' ';
    const ErrorCode kind = *code == 1   ? ErrorCode::kOverBudget
                           : *code == 2 ? ErrorCode::kUnsupported
                                        : ErrorCode::kCorruptInput;
    return Fail(kind, source_->name() + ": assimp: " + *text);
  }

  Result<void> Polygon() {
    const auto corners = child_->Number<std::uint32_t>();
    if (!corners) return Forward(corners);
    if (*corners > kMostAssimpCorners) return child_->Nonsense();
    ++counts_.faces;
    if (*corners < 3) {
      ++counts_.triangles;
      ++counts_.skipped[static_cast<std::size_t>(SkipReason::kTooFewCorners)];
    }
    corners_.resize(*corners);
    auto taken = child_->Take({reinterpret_cast<char*>(corners_.data()), *corners * sizeof(Vec3)});
    if (!taken || *corners < 3) return taken;
    pieces_.clear();
    next_piece_ = 0;
    TriangulatePolygon(corners_, pieces_);
    return {};
  }

  void Drain(TriangleBatch& batch) {
    for (; next_piece_ < pieces_.size() && !batch.full(); ++next_piece_) {
      const auto& [a, b, c] = pieces_[next_piece_];
      batch.Push(corners_[a], corners_[b], corners_[c], counts_.triangles++);
    }
  }

  static_assert(sizeof(Vec3) == 3 * sizeof(double));

  std::unique_ptr<ByteSource> source_;
  const OpenOptions options_;
  MeshInfo info_;
  std::unique_ptr<ScratchFile> copy_;
  std::uint64_t memory_ = 0;
  MemoryShare share_;
  std::unique_ptr<AssimpChild> child_;
  ReadCounts counts_;
  bool ended_ = false;
  std::vector<Vec3> corners_;
  std::vector<std::array<std::uint32_t, 3>> pieces_;
  std::size_t next_piece_ = 0;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenAssimp(std::unique_ptr<ByteSource> source,
                                               const OpenOptions& options) {
  return WithinMemory(source->name() + ": the mesh does not fit into memory",
                      [&] { return MakeLoaded<AssimpReader>(std::move(source), options); });
}

}  // namespace strata::io
