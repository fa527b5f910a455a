// Writes the seed corpora: make_seeds FOLDER creates FOLDER/ply, FOLDER/stl, … with small files
// that between them use every part of the readers.
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "tests/fuzz/mesh_seeds.h"
#include "tests/support/compress.h"
#include "tests/support/image_maker.h"
#include "tests/support/mesh_text.h"

namespace {

namespace fs = std::filesystem;
using strata::test::MakePly;
using strata::test::PlyFaces;
using strata::test::PlyPart;

void WriteAll(const fs::path& folder, const std::vector<std::string>& files) {
  fs::create_directories(folder);
  for (std::size_t i = 0; i < files.size(); ++i) {
    std::ofstream(folder / std::to_string(i), std::ios::binary) << files[i];
  }
}

std::vector<std::string> PlySeeds() {
  const PlyPart vertices = strata::test::PlyVertices(
      {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.5, 0.25, 0}, {0, 0, 1}});
  const PlyPart mixed{"vertex",
                      {"uchar red", "double x", "short y", "list uchar char l", "float z"},
                      {{7, 0.1, 0, 1, 5, 0}, {7, 1, 0, 0, 0}, {7, 0, 1, 2, 5, 6, 0}}};
  const PlyPart strips{
      "tristrips", {"list int int vertex_indices"}, {{9, 0, 1, 2, 5, -1, 1, 2, 3, -1}, {1, 0}}};
  const PlyPart extra{"edge", {"int a", "list uchar int b"}, {{1, 1, 2}, {3, 0}}};
  const PlyPart coloured{"face",
                         {"list uchar uint vertex_index", "uchar red"},
                         {{3, 0, 1, 2, 9}, {3, 0, 1, 99, 9}, {4, 0, 1, 2, 3, 9}}};
  const PlyPart faces = PlyFaces({{0, 1, 2}, {0, 1, 2, 3}, {0, 1, 2, 3, 4}, {0, 1}, {0, 5, 2}});
  std::vector<std::string> files;
  for (const std::string format : strata::test::kPlyFormats) {
    files.push_back(MakePly(format, {vertices, faces}));
    files.push_back(MakePly(format, {extra, faces, mixed, strips}, "\r\n"));
    files.push_back(MakePly(format, {vertices, coloured, strips}, "\r"));
  }
  return files;
}

std::vector<std::string> StlSeeds() {
  const std::vector<strata::test::NineFloats> facets = {{0, 0, 0, 1, 0, 0, 0, 1, 0},
                                                        {0.1f, -2e-7f, 3e10f, 1, 2, 3, 4, 5, 6}};
  return {strata::test::MakeAsciiStl(facets), strata::test::MakeBinaryStl(facets, "solid x"),
          strata::test::MakeBinaryStl(facets),
          strata::test::MakeAsciiStl(facets) + strata::test::MakeAsciiStl({})};
}

std::vector<std::string> ObjSeeds() {
  return {
      "# cube\nmtllib a.mtl\no a b\nv 0 0 0\nv 1 0 0 1\nv 0 1 0 0.5 0.5 0.5\nvt 0 0\nvn 0 0 1\n"
      "g g\nusemtl m\ns off\nf 1 2 3\nf -3/1 -2/1 \\\n -1/1\nf 1//1 2//1 3//1\nf 1/1/1 2 9\n",
      "v 0 0 0\r\nv 1 0 0\r\nv 1 1 0\r\nv 0 1 0\r\nf 1 2 3 4\r\nf 1 2\r\nl 1 2\r\np 1"};
}

std::vector<std::string> OffSeeds() {
  return {"OFF\n# comment\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3 0.5 0.5 0.5\n",
          "STCN4OFF 3 1 0\n0 0 0 1 0 0 1 1 1 1 1 0 0\n1 0 0 1 0 0 1 1 1 1 1 0 0\n"
          "0 1 0 1 0 0 1 1 1 1 1 0 0\n3 0 1 2\n",
          "COFF\n3 1 3\n0 0 0 255 0 0 255\n1 0 0 255 0 0 255\n0 1 0 255 0 0 255\n3 0 1 2 1\n",
          "COFF\n3 2 0\n0 0 0 1 0 0\n1 0 0 0 1 0\n0 1 0 0 0 1\n3 0 1 2 0.5 1 0\n3 2 1 0\n",
          "NOFF\n3 2 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n3 0 1 7\n2 0 1\n"};
}

// Bytes as triangulate_fuzz.cc takes them: a quad, a dart, a star, a keyhole, a scribble, doubles.
std::vector<std::string> PolygonSeeds() {
  const auto doubles = [](const std::vector<double>& values) {
    std::string out(1, '\x02');
    for (const double value : values) strata::test::AppendBytes<double>(value, false, out);
    return out;
  };
  return {std::string("\0\0\0\5\0\5\5\0\5", 9),
          std::string("\0\0\0\x4\xff\x1\0\x4\x1", 9),
          std::string("\0\0\0\5\3\x9\0\6\5\x9\x9\5\6\0\x9\3\5", 17),
          std::string("\0\0\0\x9\0\x9\x9\0\x9\0\0\3\3\3\6\6\6\6\3\3\3", 21),
          std::string("\1\0\0\1\x9\3\2\1\7\3\x5\x5\x5\2\x8\1\0\0\1", 19),
          doubles({0, 0, 0, 1e9, 0.1, 0, 1e9, 1e9, 1e-3, 3, 1e8, 0, -1e300, 1, 1})};
}

std::vector<std::string> ImageSeeds() {
  using namespace strata::test;
  const auto pixels = [](int channels, int bits) {
    return MakePixels(
        13, 9, channels, [](unsigned x, unsigned y, int c) { return x * 19 + y * 5 + c * 60u; },
        bits);
  };
  JpegShape progressive;
  progressive.progressive = progressive.subsampled = true;
  return {MakePng(pixels(3, 8)),
          MakePng(pixels(4, 16), {true, {}}),
          MakePng(MakePixels(4, 4, 1, [](unsigned x, unsigned, int) { return x % 2; }),
                  {false, {9, 8, 7, 255, 1, 2, 3, 4}}),
          MakeJpeg(pixels(3, 8)),
          MakeJpeg(pixels(3, 8), progressive),
          MakeJpeg(pixels(1, 8)),
          MakeJpeg(pixels(4, 8)),
          MakeWebp(pixels(4, 8)),
          MakeWebp(pixels(3, 8), false),
          MakeWebp(pixels(4, 8), false)};
}

std::vector<std::string> HttpSeeds() {
  return {
      "GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\nGET /nowhere?a=%20 HTTP/1.1\r\nHost: "
      "localhost\r\n\r\n",
      "POST /v1/samples?resolution=5&min-distance=0.5 HTTP/1.1\r\nHost: "
      "localhost\r\nContent-Length: 4\r\n"
      "Accept: text/plain;q=0.5, model/*\r\nExpect: 100-continue\r\n\r\nv 0 ",
      "POST /v1/samples?lambda=x HTTP/1.0\r\nHost: localhost\r\nTransfer-Encoding: "
      "chunked\r\n\r\n2\r\nab\r\n"
      "0\r\n\r\n",
      "GET /v1/jobs/x?wait=1 HTTP/1.1\r\nHost: localhost\r\nX-Request-Id: a\r\nRange: "
      "bytes=1-2\r\n\r\n"};
}

// Fields of SampleOptions: resolution; lambda and seed; texts; height and strict.
std::vector<std::string> WireSeeds() {
  return {"\x08\x40", std::string("\x21\0\0\0\0\0\0\x04\x40\x30\x07", 11),
          "\x3a\x05"
          "exact\x4a\x03"
          "ply\x52\x04"
          "none",
          "\x18\x05\x40\x01\x60\x64"};
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 1;
  const fs::path folder = argv[1];
  std::vector<std::string> any;
  for (const auto& [name, files] :
       {std::pair("ply", PlySeeds()), std::pair("stl", StlSeeds()), std::pair("obj", ObjSeeds()),
        std::pair("off", OffSeeds()), std::pair("gltf", GltfSeeds()),
        std::pair("drc", DracoSeeds()), std::pair("archive", ArchiveSeeds())}) {
    WriteAll(folder / name, files);
    any.insert(any.end(), files.begin(), files.end());
    any.push_back(strata::test::Gzip(files[0]));
    any.push_back(strata::test::Zstd(files[0]));
  }
  WriteAll(folder / "open_mesh", any);
  WriteAll(folder / "three_mf", ThreeMfSeeds());
  WriteAll(folder / "mtl", MtlSeeds());
  WriteAll(folder / "assimp", AssimpSeeds());
  WriteAll(folder / "triangulate", PolygonSeeds());
  WriteAll(folder / "image", ImageSeeds());
  WriteAll(folder / "http", HttpSeeds());
  WriteAll(folder / "wire", WireSeeds());
  return 0;
}
