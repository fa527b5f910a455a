// A PLY file's rows value by value, in one encoding: for what is read of few elements, or once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "io/byte_source.h"
#include "io/ply_header.h"
#include "io/ply_rows.h"

namespace strata::io {

/// The machine's type for one of PLY's.
constexpr ScalarType ScalarOf(PlyType type) {
  constexpr ScalarType kTypes[] = {ScalarType::kInt8,    ScalarType::kUint8,  ScalarType::kInt16,
                                   ScalarType::kUint16,  ScalarType::kInt32,  ScalarType::kUint32,
                                   ScalarType::kFloat32, ScalarType::kFloat64};
  return kTypes[static_cast<std::size_t>(type)];
}

/// What to do with a property of a row.
struct PlyStep {
  enum class Use : std::uint8_t {
    kPass,
    kKeep,     ///< The value, or the `length` items of a list, go to the row at `at`.
    kCorners,  ///< A list of corners.
    kWedges,   ///< A list of `length` items for each corner.
  };
  PlyProperty property;
  Use use = Use::kPass;
  std::size_t at = 0;
  std::uint64_t length = 1;
};

/// A row taken apart.
struct PlyRow {
  std::vector<char> kept;  ///< As large as the steps say.
  std::vector<std::int64_t> corners;
  std::vector<char> wedges;  ///< Empty if the list has not the right length.
};

/// Decodes values in file order, into the machine's byte order. Failures are kept: once a call has
/// returned false, failure() says why and the object is spent. Threads: one at a time.
class PlyValues {
 public:
  virtual ~PlyValues() = default;

  virtual Result<void> Seek(const PlyMark& mark) = 0;
  /// Before and after the values of a row; `left` counts it and those after it.
  virtual bool BeginRow(const PlyElement& element, std::uint64_t left) = 0;
  virtual bool EndRow() = 0;
  /// `out` takes PlySize(type) bytes.
  virtual bool Value(PlyType type, char* out) = 0;
  virtual bool Skip(PlyType type, std::uint64_t values) = 0;
  virtual bool Length(PlyType type, std::uint64_t& length) = 0;
  virtual bool Index(PlyType type, std::int64_t& index) = 0;
  virtual bool Reject(const std::string& what) = 0;
  virtual tl::unexpected<Error> failure() const = 0;
  /// Passes over rows of one size, at most `most`, for as long as each holds at byte `list` a list
  /// of three items with a length of one byte; returns how many. 0 where rows have no size (ascii).
  virtual std::uint64_t PassTriangles(std::size_t, std::size_t, std::uint64_t) { return 0; }

  /// A whole row of `element`, step by step.
  bool ReadRow(const PlyElement& element, std::uint64_t left, const std::vector<PlyStep>& steps,
               PlyRow& row);

 private:
  bool ReadStep(const PlyStep& step, PlyRow& row);
  bool ReadList(const PlyStep& step, PlyRow& row);
};

/// `input` outlives the values.
std::unique_ptr<PlyValues> OpenPlyValues(InputBuffer& input, const PlyHeader& header);

}  // namespace strata::io
