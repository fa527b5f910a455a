#include "io/detect_format.h"

#include <gtest/gtest.h>

#include <string>

#include "tests/support/mesh_text.h"

namespace strata::io {
namespace {

using namespace std::string_literals;

Result<MeshFormat> Detect(const std::string& head, const std::string& name = "file") {
  return DetectFormat({head, head.size(), name});
}

void ExpectFormat(MeshFormat format, const std::string& head, const std::string& name = "file") {
  auto found = Detect(head, name);
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(*found, format) << head;
}

void ExpectRefused(const std::string& head, const std::string& part,
                   const std::string& name = "file") {
  auto found = Detect(head, name);
  ASSERT_FALSE(found) << head;
  EXPECT_EQ(found.error().code, ErrorCode::kUnsupported);
  EXPECT_NE(found.error().message.find(part), std::string::npos) << found.error().message;
}

TEST(DetectFormat, FindsPlyByItsFirstWord) {
  for (const std::string text : {"ply\n", "ply\r\nformat", "ply\rformat", "ply \n", "\n ply\n",
                                 "\xef\xbb\xbfply\n", "ply"}) {
    ExpectFormat(MeshFormat::kPly, text, "wrong.obj");
  }
}

TEST(DetectFormat, FindsEveryMemberOfTheOffFamily) {
  for (const std::string word :
       {"OFF", "COFF", "NOFF", "STOFF", "CNOFF", "STCNOFF", "4OFF", "nOFF", "STCN4nOFF", "N4OFF"}) {
    ExpectFormat(MeshFormat::kOff, word + "\n3 1 0\n");
    ExpectFormat(MeshFormat::kOff, "# a comment\n\n# v 1\n" + word + " BINARY\n", "wrong.stl");
  }
  ExpectRefused("NCOFF\n", "begins with bytes 4e 43");
}

TEST(DetectFormat, TakesOffWithoutItsWordByTheSuffix) {
  ExpectFormat(MeshFormat::kOff, "3 1 0\n0 0 0\n", "a/b.OFF.gz");
  ExpectRefused("3 1 0\n0 0 0\n", "expected PLY, OBJ, STL, OFF");
}

TEST(DetectFormat, FindsObjByItsStatements) {
  for (const std::string line : {"v 0 0 0", "vn 0 0 1", "vt 0 0", "f 1 2 3", "o thing", "g a b",
                                 "usemtl red", "mtllib a.mtl", "s off", "l 1 2", "p 1"}) {
    ExpectFormat(MeshFormat::kObj, line + "\n", "wrong.ply");
    ExpectFormat(MeshFormat::kObj, "# comment\r\n#\r\n\r\n  " + line);
  }
  ExpectFormat(MeshFormat::kObj, "# nothing but comments\n", "a.obj");
  ExpectRefused("# nothing but comments\n", "'# nothing but co'");
}

TEST(DetectFormat, FindsStlByKeywordAndBySize) {
  const std::vector<test::NineFloats> facets(3, test::NineFloats(9, 1.5f));
  ExpectFormat(MeshFormat::kStl, test::MakeAsciiStl(facets), "wrong.obj");
  ExpectFormat(MeshFormat::kStl, "\n SOLID x\n");
  for (const std::string header : {"binary", "solid", "v 0 0 0", "{", "OFF\n", "PK\x03\x04"}) {
    ExpectFormat(MeshFormat::kStl, test::MakeBinaryStl(facets, header));
  }
}

TEST(DetectFormat, FindsBinaryStlOfUnknownSizeByItsFirstFacets) {
  const std::vector<test::NineFloats> facets(3, test::NineFloats(9, 1.5f));
  const std::string bytes = test::MakeBinaryStl(facets);
  auto found = DetectFormat({bytes, {}, "standard input"});
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(*found, MeshFormat::kStl);
  std::string noise = bytes;
  for (std::size_t i = 84; i < noise.size(); ++i) noise[i] = static_cast<char>(i * 37);
  EXPECT_FALSE(DetectFormat({noise, {}, "standard input"}));
}

TEST(DetectFormat, LeavesDamagedFilesOfAKnownSuffixToTheirReader) {
  ExpectFormat(MeshFormat::kStl, "binary\0\0\0"s, "cut.stl");
  ExpectFormat(MeshFormat::kPly, "pl", "cut.ply.zst");
  ExpectFormat(MeshFormat::kObj, "what 1 2 3\n", "odd.obj");
}

TEST(DetectFormat, FindsGltfDracoAndArchivesByTheirFirstBytes) {
  ExpectFormat(MeshFormat::kGlb, "glTF\x02\0\0\0"s, "wrong.obj");
  ExpectFormat(MeshFormat::kGltf, "\xef\xbb\xbf{ \"asset\": { \"version\": \"2.0\" } }");
  ExpectFormat(MeshFormat::kGltf, "{\n\"accessors\" : [", "wrong.ply");
  ExpectFormat(MeshFormat::kGltf, "{", "cut.gltf");
  ExpectFormat(MeshFormat::kZip, "PK\x03\x04rest"s);
  ExpectFormat(MeshFormat::k3mf, "PK\x03\x04rest"s, "model.3mf");
  ExpectFormat(MeshFormat::kDraco, "DRACO\x02\x02"s, "model.obj");
}

TEST(DetectFormat, RefusesOtherFormatsByName) {
  ExpectRefused("{ \"a\": 1 }", "JSON");
  ExpectRefused("BZh91AY", "bzip2");
  ExpectRefused(
      "\xfd"
      "7zXZ\0\0"s,
      "xz");
  ExpectRefused("\x1f\x8b\x08\0"s, "packed twice");
  ExpectRefused("Kaydara FBX Binary  \0"s, "FBX");
  ExpectRefused("# vtk DataFile Version 3.0\n", "VTK");
  ExpectRefused("<?xml version=\"1.0\"?>\n<COLLADA>", "COLLADA");
  ExpectRefused("<?xml version=\"1.0\"?>\n<other>", "XML");
}

TEST(DetectFormat, SaysWhatItFoundAndWhatItReads) {
  ExpectRefused("once upon a time there was", "'once upon a time'");
  ExpectRefused("once upon a time", "expected PLY, OBJ, STL, OFF");
  ExpectRefused("\x01\x02\xff"s, "bytes 01 02 ff");
  auto empty = Detect("");
  ASSERT_FALSE(empty);
  EXPECT_EQ(empty.error().code, ErrorCode::kCorruptInput);
  EXPECT_NE(empty.error().message.find("empty"), std::string::npos);
}

TEST(MeshSuffix, PassesOverTheSuffixOfTheCompression) {
  EXPECT_EQ(MeshSuffix("a.ply"), "ply");
  EXPECT_EQ(MeshSuffix("a.b/Model.PLY.gz"), "ply");
  EXPECT_EQ(MeshSuffix("x.stl.zst"), "stl");
  EXPECT_EQ(MeshSuffix("x.gz"), "");
  EXPECT_EQ(MeshSuffix("a.b/model"), "");
  EXPECT_EQ(MeshSuffix(""), "");
}

}  // namespace
}  // namespace strata::io
