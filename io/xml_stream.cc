#include "io/xml_stream.h"

#include <expat.h>

#include <algorithm>
#include <utility>

namespace strata::io {
namespace {
constexpr int kMostDepth = 256;
constexpr std::size_t kPiece = std::size_t{1} << 20;
}  // namespace

struct XmlStream::State {
  std::string who;
  Handler* handler = nullptr;
  XML_Parser parser = nullptr;
  std::optional<Error> failure;
  int depth = 0;

  void Fail(ErrorCode code, const std::string& what) {
    if (!failure) {
      failure = Error{
          code, who + ": line " + std::to_string(XML_GetCurrentLineNumber(parser)) + ": " + what};
    }
    XML_StopParser(parser, XML_FALSE);
  }
  void Note(const Result<void>& outcome) {
    if (!outcome) Fail(outcome.error().code, outcome.error().message);
  }

  static void XMLCALL Begin(void* self, const char* name, const char** attributes) {
    auto& state = *static_cast<State*>(self);
    if (++state.depth > kMostDepth) {
      return state.Fail(ErrorCode::kCorruptInput, "elements are nested too deeply");
    }
    state.Note(state.handler->Begin(name, XmlAttributes(attributes)));
  }
  static void XMLCALL End(void* self, const char* name) {
    auto& state = *static_cast<State*>(self);
    --state.depth;
    if (!state.failure) state.Note(state.handler->End(name));
  }
  static void XMLCALL Doctype(void* self, const char*, const char*, const char*, int) {
    static_cast<State*>(self)->Fail(ErrorCode::kCorruptInput,
                                    "found a document type, expected none");
  }
  static void XMLCALL Namespace(void* self, const char* prefix, const char* uri) {
    static_cast<State*>(self)->handler->Prefix(prefix == nullptr ? "" : prefix,
                                               uri == nullptr ? "" : uri);
  }
};

const char* XmlAttributes::Find(std::string_view name) const {
  for (const char** pair = pairs_; *pair != nullptr; pair += 2) {
    if (name == *pair) return pair[1];
  }
  return nullptr;
}

XmlStream::XmlStream(std::string who, Handler& handler) : state_(std::make_unique<State>()) {
  state_->who = std::move(who);
  state_->handler = &handler;
  state_->parser = XML_ParserCreateNS(nullptr, '|');
  if (state_->parser == nullptr) throw std::bad_alloc();
  XML_SetUserData(state_->parser, state_.get());
  XML_SetElementHandler(state_->parser, &State::Begin, &State::End);
  XML_SetStartDoctypeDeclHandler(state_->parser, &State::Doctype);
  XML_SetStartNamespaceDeclHandler(state_->parser, &State::Namespace);
}

XmlStream::~XmlStream() { XML_ParserFree(state_->parser); }

Result<void> XmlStream::Put(std::span<const char> bytes) {
  while (!bytes.empty()) {
    const std::size_t n = std::min(bytes.size(), kPiece);
    if (auto ok = Parse(bytes.data(), n, false); !ok) return ok;
    bytes = bytes.subspan(n);
  }
  return {};
}

Result<void> XmlStream::Finish() { return Parse("", 0, true); }

Result<void> XmlStream::Parse(const char* bytes, std::size_t size, bool last) {
  const XML_Status status =
      XML_Parse(state_->parser, bytes, static_cast<int>(size), last ? XML_TRUE : XML_FALSE);
  if (state_->failure) return tl::unexpected<Error>(*state_->failure);
  if (status == XML_STATUS_OK) return {};
  const XML_Error error = XML_GetErrorCode(state_->parser);
  const bool memory = error == XML_ERROR_NO_MEMORY;
  state_->Fail(memory ? ErrorCode::kOverBudget : ErrorCode::kCorruptInput,
               std::string("not well-formed XML: ") + XML_ErrorString(error));
  return tl::unexpected<Error>(*state_->failure);
}

}  // namespace strata::io
