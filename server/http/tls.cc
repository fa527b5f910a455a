#include "server/http/tls.h"

#include <openssl/ssl.h>
#include <sys/socket.h>

#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <utility>

#include "server/http/socket_stream.h"

namespace strata::server {
namespace {

namespace ssl = boost::asio::ssl;
using boost::system::error_code;

class Tls final : public Transport {
 public:
  Tls(int socket, ssl::context& context) : stream_(socket, context) {}
  std::size_t ReadSome(void* into, std::size_t size, error_code& error) override {
    return stream_.read_some(boost::asio::buffer(into, size), error);
  }
  std::size_t WriteSome(const void* from, std::size_t size, error_code& error) override {
    return stream_.write_some(boost::asio::buffer(from, size), error);
  }
  void Handshake(error_code& error) override { stream_.handshake(ssl::stream_base::server, error); }
  void FinishWriting() override {
    // The answer to close_notify is not waited for: the socket's end says the same.
    SSL_set_shutdown(stream_.native_handle(), SSL_RECEIVED_SHUTDOWN);
    error_code ignored;
    stream_.shutdown(ignored);
    shutdown(stream_.next_layer().descriptor(), SHUT_WR);
  }
  void SetDeadline(SteadyClock::time_point deadline) override {
    stream_.next_layer().SetDeadline(deadline);
  }
  void SetStop(int stop) override { stream_.next_layer().SetStop(stop); }
  int descriptor() const override { return stream_.next_layer().descriptor(); }

 private:
  ssl::stream<SocketStream> stream_;
};

}  // namespace

struct TlsContext::Library {
  ssl::context context{ssl::context::tls_server};
};

TlsContext::TlsContext(std::unique_ptr<Library> library) : library_(std::move(library)) {}
TlsContext::~TlsContext() = default;

Result<std::unique_ptr<TlsContext>> TlsContext::Load(const TlsFiles& files) {
  auto library = std::make_unique<Library>();
  const auto failed = [](const std::string& file, const error_code& error) {
    return Fail(ErrorCode::kInvalidArgument, file + ": " + error.message());
  };
  ssl::context& context = library->context;
  error_code error;
  context.set_options(ssl::context::default_workarounds | ssl::context::no_tlsv1 |
                          ssl::context::no_tlsv1_1 | ssl::context::no_compression,
                      error);
  context.use_certificate_chain_file(files.certificate, error);
  if (error) return failed(files.certificate, error);
  context.use_private_key_file(files.key, ssl::context::pem, error);
  if (error) return failed(files.key, error);
  if (!files.client_ca.empty()) {
    context.load_verify_file(files.client_ca, error);
    if (error) return failed(files.client_ca, error);
    context.set_verify_mode(ssl::verify_peer | ssl::verify_fail_if_no_peer_cert, error);
  }
  return std::unique_ptr<TlsContext>(new TlsContext(std::move(library)));
}

std::unique_ptr<Transport> TlsContext::Wrap(int socket) {
  return std::make_unique<Tls>(socket, library_->context);
}

}  // namespace strata::server
