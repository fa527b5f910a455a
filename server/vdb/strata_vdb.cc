// strata-vdb: takes samples from standard input as io/vdb_stream.h says, makes OpenVDB's grid of
// them and writes it to descriptor 3.
//
// A program of its own because loading OpenVDB's library takes longer than sampling a small mesh
// (docs/adr/0005, docs/adr/0025). What happens to it is the caller's to notice.
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <tbb/global_control.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <exception>
#include <new>
#include <string>
#include <string_view>
#include <vector>

#include "core/packing.h"
#include "io/vdb_stream.h"
#include "server/vdb/point_grid.h"

namespace {

using strata::io::VdbAnswer;
using strata::io::VdbHead;

constexpr int kSocket = 0;

// What is on the way from the parent. Its end before its time ends the program: nobody waits.
class Input {
 public:
  Input() : buffer_(std::size_t{1} << 18) {}
  void Take(char* out, std::size_t n) {
    while (n > 0) {
      if (begin_ == end_) Fill();
      const std::size_t part = std::min(n, end_ - begin_);
      std::copy_n(buffer_.data() + begin_, part, out);
      begin_ += part;
      out += part;
      n -= part;
    }
  }

 private:
  void Fill() {
    ssize_t n;
    do {
      n = read(kSocket, buffer_.data(), buffer_.size());
    } while (n < 0 && errno == EINTR);
    if (n <= 0) _exit(1);
    begin_ = 0;
    end_ = static_cast<std::size_t>(n);
  }
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
};

[[noreturn]] void Reply(VdbAnswer::Kind kind, std::uint64_t number, const char* why = "") {
  std::string_view text(why);
  text = text.substr(0, 4096);
  VdbAnswer answer;
  answer.kind = kind;
  answer.number = number;
  answer.text_bytes = static_cast<std::uint32_t>(text.size());
  const bool sent =
      send(kSocket, &answer, sizeof answer, MSG_NOSIGNAL) == static_cast<ssize_t>(sizeof answer) &&
      send(kSocket, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
  _exit(sent ? 0 : 1);
}

// Private memory that can be written, as for the service's jobs: an allocation beyond the budget
// fails. The bound that is kept is PointGrid's own; this one is for what that does not know.
void LimitMemory(std::uint64_t bytes) {
  if (bytes == 0) return;
  constexpr rlim_t kOwn = rlim_t{64} << 20;
  rlimit limit{};
  if (getrlimit(RLIMIT_DATA, &limit) != 0) return;
  limit.rlim_cur = std::min<rlim_t>({limit.rlim_cur, limit.rlim_max, bytes + bytes / 4 + kOwn});
  static_cast<void>(setrlimit(RLIMIT_DATA, &limit));
}

VdbHead TakeHead(Input& input) {
  std::uint64_t size = 0;
  input.Take(reinterpret_cast<char*>(&size), sizeof size);
  std::string bytes(size, '\0');
  input.Take(bytes.data(), bytes.size());
  VdbHead head;
  strata::Unpacker unpacker(bytes);
  PackHead(head, unpacker);
  if (!unpacker.done()) Reply(VdbAnswer::kFailed, 0, "the grid's head cannot be understood");
  return head;
}

void Run() {
  Input input;
  const VdbHead head = TakeHead(input);
  LimitMemory(head.memory_bytes);
  strata::server::PointGrid grid(head);
  std::vector<char> row(strata::io::VdbRowBytes(head.attributes));
  for (std::uint64_t i = 0; i < head.count; ++i) {
    input.Take(row.data(), row.size());
    grid.Add(row.data());
  }
  grid.End();
  if (grid.over_memory()) Reply(VdbAnswer::kOverMemory, grid.bytes());
  Reply(VdbAnswer::kDone, grid.Write(strata::io::kVdbOutput));
}

}  // namespace

int main() {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  signal(SIGXFSZ, SIG_IGN);  // A full disk is an errno.
  const rlimit none{0, 0};
  static_cast<void>(setrlimit(RLIMIT_CORE, &none));
  try {
    // Threads would take memory, and there is nothing for them to do.
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    Run();
  } catch (const strata::server::DiskError& e) {
    Reply(VdbAnswer::kDisk, static_cast<std::uint64_t>(e.number));
  } catch (const std::bad_alloc&) {
    Reply(VdbAnswer::kOverMemory, 0);
  } catch (const std::exception& e) {
    Reply(VdbAnswer::kFailed, 0, e.what());
  }
}
