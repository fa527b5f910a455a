// XML that arrives piece by piece, from a file that may be anything.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/result.h"

namespace strata::io {

/// Attributes of an element, as they stand in it; valid within the call.
class XmlAttributes {
 public:
  explicit XmlAttributes(const char** pairs) : pairs_(pairs) {}
  /// Null if it is not there. A name in a namespace is "<uri>|<name>".
  const char* Find(std::string_view name) const;

 private:
  const char** pairs_;
};

/// Hands out elements. Names are "<uri>|<name>" where they have a namespace. A document type is an
/// error, so that there are no entities to expand; so is nesting beyond 256. Threads: one.
class XmlStream {
 public:
  class Handler {
   public:
    virtual ~Handler() = default;
    /// Errors stop the stream, with the line put in front.
    virtual Result<void> Begin(std::string_view name, const XmlAttributes& attributes) = 0;
    virtual Result<void> End(std::string_view name) = 0;
    /// A prefix that the element to come declares.
    virtual void Prefix(std::string_view prefix, std::string_view uri) {}
  };

  /// `who` names the document in messages; `handler` must outlive the stream.
  XmlStream(std::string who, Handler& handler);
  ~XmlStream();
  XmlStream(const XmlStream&) = delete;
  XmlStream& operator=(const XmlStream&) = delete;

  Result<void> Put(std::span<const char> bytes);
  /// After the last byte.
  Result<void> Finish();

 private:
  struct State;
  Result<void> Parse(const char* bytes, std::size_t size, bool last);
  std::unique_ptr<State> state_;
};

}  // namespace strata::io
