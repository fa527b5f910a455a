// Connections under TLS, for HTTP. (gRPC has its own, from the same files.)
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "server/http/transport.h"

namespace strata::server {

/// PEM files. TLS is on when both certificate and key are named.
struct TlsFiles {
  std::string certificate;  ///< The server's, with the chain after it.
  std::string key;          ///< Its private key.
  std::string client_ca;  ///< Not empty: clients must show a certificate that one of these signed.
  bool on() const { return !certificate.empty(); }
};

/// Certificates, read once. Threads: any.
class TlsContext {
 public:
  /// TLS 1.2 or newer. Errors: kInvalidArgument, naming the file and the library's reason.
  static Result<std::unique_ptr<TlsContext>> Load(const TlsFiles& files);
  ~TlsContext();

  /// Takes over a connected socket.
  std::unique_ptr<Transport> Wrap(int socket);

 private:
  struct Library;
  explicit TlsContext(std::unique_ptr<Library> library);
  std::unique_ptr<Library> library_;
};

}  // namespace strata::server
