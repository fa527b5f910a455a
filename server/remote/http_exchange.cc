#include "server/remote/http_exchange.h"

#include <curl/curl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "core/lower_case.h"
#include "core/signal_shield.h"
#include "core/version.h"

namespace strata::server {
namespace {

constexpr std::size_t kMaxBody = std::size_t{16} << 20;
constexpr std::size_t kMaxHeaders = 128;
constexpr std::size_t kMaxIdle = 64;

/// One exchange, as libcurl's callbacks see it.
struct Exchange {
  const HttpRequest* request = nullptr;
  HttpAnswer* answer = nullptr;
  const std::function<bool()>* cancelled = nullptr;
  CURL* easy = nullptr;
  std::uint64_t sent = 0;  // Of the payload.
  bool began = false;      // The body of the answer.

  bool HasContent() const { return answer->status == 200 || answer->status == 206; }
};

std::string_view Trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\r\n";
  const std::size_t begin = text.find_first_not_of(kBlanks);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kBlanks) - begin + 1);
}

// Exceptions must not pass through libcurl: bad_alloc is the only one that these can meet.
std::size_t OnHeader(char* bytes, std::size_t, std::size_t size, void* user) noexcept try {
  auto& exchange = *static_cast<Exchange*>(user);
  const std::string_view line(bytes, size);
  HttpAnswer& answer = *exchange.answer;
  if (line.starts_with("HTTP/")) {  // Also after "100 Continue": what counts comes last.
    long status = 0;
    curl_easy_getinfo(exchange.easy, CURLINFO_RESPONSE_CODE, &status);
    answer.status = static_cast<int>(status);
    answer.headers.clear();
    return size;
  }
  const std::size_t colon = line.find(':');
  if (colon != std::string_view::npos && answer.headers.size() < kMaxHeaders) {
    answer.headers[LowerCase(line.substr(0, colon))] = Trimmed(line.substr(colon + 1));
  }
  return size;
} catch (...) {
  return 0;
}

/// libcurl counts any number but `size` as a refusal.
std::size_t OnBody(char* bytes, std::size_t, std::size_t size, void* user) noexcept try {
  auto& exchange = *static_cast<Exchange*>(user);
  HttpAnswer& answer = *exchange.answer;
  const HttpRequest& request = *exchange.request;
  const std::string_view part(bytes, size);
  if (request.sink && exchange.HasContent()) {
    if (!exchange.began && request.begin && !request.begin(answer.status, answer.headers)) {
      answer.broken_off = true;
      return 0;
    }
    exchange.began = true;
    answer.broken_off = !request.sink(part);
    return answer.broken_off ? 0 : size;
  }
  if (answer.body.size() + size > kMaxBody) {
    answer.failure = "an answer of more than 16 MiB";
    answer.broken_off = true;
    return 0;
  }
  answer.body += part;
  return size;
} catch (...) {
  return 0;
}

std::size_t OnRead(char* bytes, std::size_t, std::size_t size, void* user) noexcept {
  auto& exchange = *static_cast<Exchange*>(user);
  const Payload& payload = exchange.request->payload;
  size = static_cast<std::size_t>(std::min<std::uint64_t>(size, payload.size - exchange.sent));
  if (payload.fd < 0) {
    std::memcpy(bytes, payload.text.data() + exchange.sent, size);
    exchange.sent += size;
    return size;
  }
  ssize_t count = -1;
  do {
    count = pread(payload.fd, bytes, size, static_cast<off_t>(payload.offset + exchange.sent));
  } while (count < 0 && errno == EINTR);
  // A file that ends before its part does is an error: zero would end the body early.
  if (count < 0 || (count == 0 && size > 0)) return CURL_READFUNC_ABORT;
  exchange.sent += static_cast<std::uint64_t>(count);
  return static_cast<std::size_t>(count);
}

/// When a kept connection turns out to be closed, libcurl begins again.
int OnSeek(void* user, curl_off_t offset, int origin) noexcept {
  auto& exchange = *static_cast<Exchange*>(user);
  if (origin != SEEK_SET || offset < 0) return CURL_SEEKFUNC_FAIL;
  exchange.sent = static_cast<std::uint64_t>(offset);
  return exchange.sent <= exchange.request->payload.size ? CURL_SEEKFUNC_OK : CURL_SEEKFUNC_FAIL;
}

int OnProgress(void* user, curl_off_t, curl_off_t, curl_off_t, curl_off_t) noexcept {
  auto& exchange = *static_cast<Exchange*>(user);
  if (exchange.request->even_if_cancelled) return 0;
  if (!*exchange.cancelled || !(*exchange.cancelled)()) return 0;
  exchange.answer->broken_off = true;
  return 1;
}

bool IsTransient(CURLcode code) {
  switch (code) {
    case CURLE_COULDNT_RESOLVE_PROXY:
    case CURLE_COULDNT_RESOLVE_HOST:
    case CURLE_COULDNT_CONNECT:
    case CURLE_PARTIAL_FILE:
    case CURLE_OPERATION_TIMEDOUT:
    case CURLE_SSL_CONNECT_ERROR:
    case CURLE_GOT_NOTHING:
    case CURLE_SEND_ERROR:
    case CURLE_RECV_ERROR:
    case CURLE_WEIRD_SERVER_REPLY:
    case CURLE_BAD_CONTENT_ENCODING:
      return true;
    default:
      return false;
  }
}

struct FreeList {
  void operator()(curl_slist* list) const { curl_slist_free_all(list); }
};
using List = std::unique_ptr<curl_slist, FreeList>;

List ListOf(const std::vector<std::string>& lines) {
  List list;
  for (const std::string& line : lines) {
    curl_slist* const longer = curl_slist_append(list.get(), line.c_str());
    if (longer == nullptr) throw std::bad_alloc();
    (void)list.release();
    list.reset(longer);
  }
  return list;
}

}  // namespace

std::string HttpAnswer::Header(const std::string& name) const {
  const auto found = headers.find(name);
  return found != headers.end() ? found->second : std::string();
}

class HttpPool::Connection {
 public:
  Connection() : easy_(curl_easy_init()) {
    if (easy_ == nullptr) throw std::bad_alloc();
  }
  ~Connection() { curl_easy_cleanup(easy_); }
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  HttpAnswer Exchange(const S3Config& config, const HttpRequest& request,
                      const std::function<bool()>& cancelled) {
    HttpAnswer answer;
    server::Exchange exchange{&request, &answer, &cancelled, easy_};
    curl_easy_reset(easy_);  // Keeps connections.
    const List headers = ListOf(request.headers);
    std::string error(CURL_ERROR_SIZE, '\0');
    Set(CURLOPT_ERRORBUFFER, error.data());
    Set(CURLOPT_HTTPHEADER, headers.get());
    SetManner(config, request);
    SetCallbacks(exchange);
    SetMethod(request);
    // OpenSSL writes without MSG_NOSIGNAL.
    const SignalShield shield({SIGPIPE});
    const CURLcode code = curl_easy_perform(easy_);
    Set(CURLOPT_HTTPHEADER, static_cast<curl_slist*>(nullptr));
    Set(CURLOPT_ERRORBUFFER, static_cast<char*>(nullptr));
    if (code != CURLE_OK && answer.failure.empty()) {
      answer.failure = error[0] != '\0' ? error.c_str() : curl_easy_strerror(code);
    }
    answer.transient = code != CURLE_OK && !answer.broken_off && IsTransient(code);
    return answer;
  }

 private:
  template <class Value>
  void Set(CURLoption option, Value value) {
    curl_easy_setopt(easy_, option, value);
  }

  void SetManner(const S3Config& config, const HttpRequest& request) {
    Set(CURLOPT_URL, request.url.c_str());
    Set(CURLOPT_PATH_AS_IS, 1L);  // A key may hold "/../": its bytes are what is signed.
    Set(CURLOPT_PROTOCOLS_STR, "http,https");
    Set(CURLOPT_FOLLOWLOCATION, 0L);  // The signature holds for one host.
    Set(CURLOPT_HTTP_VERSION, static_cast<long>(CURL_HTTP_VERSION_1_1));
    Set(CURLOPT_USERAGENT, ("strata/" + std::string(kVersion)).c_str());
    Set(CURLOPT_AWS_SIGV4, ("aws:amz:" + request.region + ":s3").c_str());
    Set(CURLOPT_USERNAME, config.access_key.c_str());
    Set(CURLOPT_PASSWORD, config.secret_key.c_str());
    if (!config.ca_file.empty()) Set(CURLOPT_CAINFO, config.ca_file.c_str());
    // A proxy from the environment would carry off what is meant for this machine.
    if (IsLoopback(request.url)) Set(CURLOPT_PROXY, "");
    Set(CURLOPT_NOSIGNAL, 1L);
    Set(CURLOPT_CONNECTTIMEOUT, 10L);
    Set(CURLOPT_TCP_KEEPALIVE, 1L);
    Set(CURLOPT_BUFFERSIZE, 256L << 10);
    Set(CURLOPT_UPLOAD_BUFFERSIZE, 256L << 10);
    if (request.patience_seconds > 0) {
      Set(CURLOPT_TIMEOUT, static_cast<long>(request.patience_seconds));
    } else {
      Set(CURLOPT_LOW_SPEED_LIMIT, 1024L);
      Set(CURLOPT_LOW_SPEED_TIME, static_cast<long>(config.stall_seconds));
    }
  }

  void SetCallbacks(server::Exchange& exchange) {
    Set(CURLOPT_HEADERFUNCTION, OnHeader);
    Set(CURLOPT_HEADERDATA, &exchange);
    Set(CURLOPT_WRITEFUNCTION, OnBody);
    Set(CURLOPT_WRITEDATA, &exchange);
    Set(CURLOPT_READFUNCTION, OnRead);
    Set(CURLOPT_READDATA, &exchange);
    Set(CURLOPT_SEEKFUNCTION, OnSeek);
    Set(CURLOPT_SEEKDATA, &exchange);
    Set(CURLOPT_XFERINFOFUNCTION, OnProgress);
    Set(CURLOPT_XFERINFODATA, &exchange);
    Set(CURLOPT_NOPROGRESS, 0L);
  }

  void SetMethod(const HttpRequest& request) {
    const auto size = static_cast<curl_off_t>(request.payload.size);
    if (request.method == "HEAD") {
      Set(CURLOPT_NOBODY, 1L);
    } else if (request.method == "PUT") {
      Set(CURLOPT_UPLOAD, 1L);
      Set(CURLOPT_INFILESIZE_LARGE, size);
    } else if (request.method == "POST") {
      Set(CURLOPT_POST, 1L);
      Set(CURLOPT_POSTFIELDSIZE_LARGE, size);
    } else {
      Set(CURLOPT_HTTPGET, 1L);
      if (request.method != "GET") Set(CURLOPT_CUSTOMREQUEST, request.method.c_str());
    }
  }

  CURL* easy_;
};

HttpPool::HttpPool(const S3Config& config, std::function<bool()> cancelled)
    : config_(config), cancelled_(std::move(cancelled)) {
  static std::once_flag once;
  std::call_once(once, [] { curl_global_init(CURL_GLOBAL_DEFAULT); });
}

HttpPool::~HttpPool() = default;

HttpAnswer HttpPool::Exchange(const HttpRequest& request) {
  std::unique_ptr<Connection> connection = Take();
  HttpAnswer answer = connection->Exchange(config_, request, cancelled_);
  GiveBack(std::move(connection));
  return answer;
}

std::unique_ptr<HttpPool::Connection> HttpPool::Take() {
  const std::lock_guard lock(mutex_);
  if (idle_.empty()) return std::make_unique<Connection>();
  std::unique_ptr<Connection> connection = std::move(idle_.back());
  idle_.pop_back();
  return connection;
}

void HttpPool::GiveBack(std::unique_ptr<Connection> connection) {
  const std::lock_guard lock(mutex_);
  if (idle_.size() < kMaxIdle) idle_.push_back(std::move(connection));
}

}  // namespace strata::server
