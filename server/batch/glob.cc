#include "server/batch/glob.h"

#include <algorithm>
#include <cstddef>
#include <vector>

namespace strata::server {
namespace {

/// One step of a glob.
struct Token {
  enum Kind { kByte, kAnyByte, kSet, kStar, kDeepStar, kDeepFolders } kind = kByte;
  std::string_view text;  // The byte, or what stands between the brackets.
};

/// The end of the set that begins after '[' at `at`, or npos when the bracket is never closed.
std::size_t EndOfSet(std::string_view glob, std::size_t at) {
  if (at < glob.size() && (glob[at] == '!' || glob[at] == '^')) ++at;
  return glob.find(']', at + 1);  // A ']' that comes first is one of the set.
}

std::vector<Token> Tokens(std::string_view glob) {
  std::vector<Token> tokens;
  for (std::size_t i = 0; i < glob.size();) {
    const std::string_view rest = glob.substr(i);
    if (rest.starts_with("**/") && (i == 0 || glob[i - 1] == '/')) {
      tokens.push_back({Token::kDeepFolders, {}});
      i += 3;
    } else if (rest.starts_with("**")) {
      tokens.push_back({Token::kDeepStar, {}});
      i += 2;
    } else if (rest[0] == '*') {
      tokens.push_back({Token::kStar, {}});
      ++i;
    } else if (rest[0] == '?') {
      tokens.push_back({Token::kAnyByte, {}});
      ++i;
    } else if (const auto end = EndOfSet(glob, i + 1); rest[0] == '[' && end != glob.npos) {
      tokens.push_back({Token::kSet, glob.substr(i + 1, end - i - 1)});
      i = end + 1;
    } else {
      if (rest[0] == '\\' && rest.size() > 1) ++i;
      tokens.push_back({Token::kByte, glob.substr(i, 1)});
      ++i;
    }
  }
  return tokens;
}

bool InSet(std::string_view set, char byte) {
  const bool inverted = set.starts_with('!') || set.starts_with('^');
  if (inverted) set.remove_prefix(1);
  const auto code = [](char c) { return static_cast<unsigned char>(c); };
  bool found = false;
  for (std::size_t i = 0; i < set.size(); ++i) {
    if (i + 2 < set.size() && set[i + 1] == '-') {
      found = found || (code(byte) >= code(set[i]) && code(byte) <= code(set[i + 2]));
      i += 2;
    } else {
      found = found || byte == set[i];
    }
  }
  return found != inverted;
}

bool TakesByte(const Token& token, char byte) {
  switch (token.kind) {
    case Token::kByte:
      return byte == token.text[0];
    case Token::kAnyByte:
    case Token::kStar:
      return byte != '/';
    case Token::kSet:
      return byte != '/' && InSet(token.text, byte);
    case Token::kDeepStar:
    case Token::kDeepFolders:
      return true;
  }
  return false;
}

bool IsStar(const Token& token) { return token.kind >= Token::kStar; }

/// `reached[t]`: the first t tokens match the path so far. A star may match nothing.
void PassStars(const std::vector<Token>& tokens, std::vector<char>& reached, bool at_segment) {
  for (std::size_t t = 0; t < tokens.size(); ++t) {
    const bool may_end = tokens[t].kind != Token::kDeepFolders || at_segment;
    if (reached[t] && IsStar(tokens[t]) && may_end) reached[t + 1] = true;
  }
}

bool MatchesWhole(std::string_view glob, std::string_view path) {
  const std::vector<Token> tokens = Tokens(glob);
  std::vector<char> reached(tokens.size() + 1, false), next;
  reached[0] = true;
  PassStars(tokens, reached, true);
  for (const char byte : path) {
    next.assign(tokens.size() + 1, false);
    for (std::size_t t = 0; t < tokens.size(); ++t) {
      if (reached[t] && TakesByte(tokens[t], byte)) next[IsStar(tokens[t]) ? t : t + 1] = true;
    }
    PassStars(tokens, next, byte == '/');
    reached.swap(next);
  }
  return reached.back();
}

/// A glob, and where it is to match.
struct Pattern {
  std::string_view glob;  // Without what says where.
  bool anywhere = false;  // In any folder, rather than from the root on.
};

/// Takes "./" and "/" from the front, which bind to the root, and '/' from the end.
Pattern PatternOf(std::string_view glob) {
  bool from_root = false;
  while (glob.starts_with("./") || glob.starts_with('/')) {
    glob.remove_prefix(glob.starts_with('/') ? 1 : 2);
    from_root = true;
  }
  while (glob.ends_with('/')) glob.remove_suffix(1);
  return {glob, !from_root && glob.find('/') == glob.npos};
}

bool MatchesFolder(const Pattern& pattern, std::string_view folder) {
  if (pattern.anywhere) folder.remove_prefix(folder.rfind('/') + 1);
  return !pattern.glob.empty() && MatchesWhole(pattern.glob, folder);
}

}  // namespace

bool MatchesGlob(std::string_view glob, std::string_view path) {
  const Pattern pattern = PatternOf(glob);
  if (!glob.ends_with('/')) return MatchesFolder(pattern, path);
  for (std::size_t end = path.find('/'); end != path.npos; end = path.find('/', end + 1)) {
    if (MatchesFolder(pattern, path.substr(0, end))) return true;
  }
  return false;
}

bool MatchesAllBelow(std::string_view glob, std::string_view folder) {
  constexpr std::string_view kAll = "/**";
  if (glob.ends_with('/')) return MatchesFolder(PatternOf(glob), folder);
  if (!glob.ends_with(kAll)) return false;
  // What is left of "a/**" begins at the root, also without a '/'.
  Pattern pattern = PatternOf(glob.substr(0, glob.size() - kAll.size()));
  pattern.anywhere = false;
  return MatchesFolder(pattern, folder);
}

}  // namespace strata::server
