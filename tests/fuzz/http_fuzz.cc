// Arbitrary bytes as what an HTTP client sends, whole and in dribs: the same answers come, and each
// begins like one. No job runs: all of them together have no memory.
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/error.hpp>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>

#include "server/http/connection.h"
#include "server/service/log.h"
#include "tests/fuzz/drain.h"

namespace {

using strata::server::SteadyClock;

/// A connection from memory: what it is sent, and what it answered.
class MemoryTransport final : public strata::server::Transport {
 public:
  MemoryTransport(std::string_view bytes, std::size_t step) : bytes_(bytes), step_(step) {
    std::array<int, 2> ends;
    strata::test::Require(socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()) == 0);
    close(ends[1]);  // The client has sent all it will.
    socket_ = ends[0];
  }
  ~MemoryTransport() override { close(socket_); }
  std::size_t ReadSome(void* into, std::size_t size, boost::system::error_code& error) override {
    const std::size_t n = std::min({size, step_, bytes_.size()});
    error = {};
    if (n == 0) error = boost::asio::error::eof;
    std::memcpy(into, bytes_.data(), n);
    bytes_.remove_prefix(n);
    return n;
  }
  std::size_t WriteSome(const void* from, std::size_t size,
                        boost::system::error_code& error) override {
    error = {};
    answer.append(static_cast<const char*>(from), size);
    return size;
  }
  void Handshake(boost::system::error_code& error) override { error = {}; }
  void FinishWriting() override {}
  void SetDeadline(SteadyClock::time_point) override {}
  void SetStop(int) override {}
  int descriptor() const override { return socket_; }

  std::string answer;

 private:
  std::string_view bytes_;
  std::size_t step_;
  int socket_ = -1;
};

strata::server::Service& TheService() {
  static strata::server::Metrics metrics;
  static std::unique_ptr<strata::server::Service> service = [] {
    strata::server::StartLog(strata::server::LogFormat::kJson, strata::server::LogLevel::kError);
    strata::server::ServiceLimits limits;
    limits.body_bytes = 4096;
    limits.requests = 4;
    limits.job_memory_bytes = 1;
    limits.job_threads = 1;
    auto scratch = strata::ScratchFolder::Open("/tmp");
    strata::test::Require(scratch.has_value());
    return std::make_unique<strata::server::Service>(limits, strata::server::ApiKeys(),
                                                     *std::move(scratch), metrics);
  }();
  return *service;
}

/// How many answers came, by their first lines.
std::size_t Serve(std::string_view bytes, std::size_t step) {
  MemoryTransport transport(bytes, step);
  strata::server::HttpShared shared{TheService(), {}, -1};
  strata::server::ServeConnection(shared, transport);
  strata::test::Require(transport.answer.empty() || transport.answer.starts_with("HTTP/1."));
  std::size_t answers = 0;
  for (std::size_t at = 0; (at = transport.answer.find("X-Request-Id: ", at)) != std::string::npos;
       ++at) {
    ++answers;
  }
  return answers;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::test::Require(Serve(bytes, bytes.size() + 1) == Serve(bytes, 1 + size % 7));
  return 0;
}
