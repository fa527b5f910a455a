// The oracle is NumPy itself: a script loads the file and prints every number's bits.
#include <gtest/gtest.h>
#include <stdio.h>

#include <bit>
#include <sstream>

#include "io/sample_writer.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::HeaderFor;
using test::MessageOf;
using test::RandomSamples;
using test::TempFolder;
using test::WriteSamples;

const char* const kScript = R"(
import sys, zipfile
import numpy as np
assert zipfile.ZipFile(sys.argv[1]).testzip() is None
z = np.load(sys.argv[1], allow_pickle=False)
for name in sorted(z.files):
    a = z[name]
    print(name, a.dtype.str if a.dtype.kind != 'U' else 'U', *a.shape)
    if a.dtype.kind == 'U':
        print(str(a).encode('utf-8').hex())
    else:
        print(' '.join(str(v) for v in np.ascontiguousarray(a).view('<u%d' % a.itemsize).ravel()))
)";

struct Output {
  int status = -1;
  std::string text;
};

Output RunPython(const TempFolder& folder, const std::string& script, const std::string& argument) {
  test::WriteFile(folder / "script.py", script);
  const std::string command =
      std::string(STRATA_TEST_PYTHON) + " '" + (folder / "script.py") + "' '" + argument + "' 2>&1";
  Output output;
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return output;
  char part[4096];
  while (const std::size_t n = fread(part, 1, sizeof part, pipe)) output.text.append(part, n);
  output.status = pclose(pipe);
  return output;
}

bool HaveNumpy() {
  return std::string(STRATA_TEST_PYTHON) != "" &&
         system((std::string(STRATA_TEST_PYTHON) + " -c 'import numpy' >/dev/null 2>&1").c_str()) ==
             0;
}

template <class Word, class T>
std::string Bits(const std::vector<T>& column) {
  std::string text;
  const std::size_t n = column.size() * sizeof(T) / sizeof(Word);
  for (std::size_t i = 0; i < n; ++i) {
    Word word;
    memcpy(&word, reinterpret_cast<const char*>(column.data()) + i * sizeof word, sizeof word);
    text += (i > 0 ? " " : "") + std::to_string(word);
  }
  return text;
}

std::string Hex(const std::string& bytes) {
  std::ostringstream out;
  for (const unsigned char c : bytes) out << std::hex << (c >> 4) << (c & 15);
  return out.str();
}

TEST(NpzWriter, NumpyReadsEveryBitOfEveryColumn) {
  if (!HaveNumpy()) GTEST_SKIP() << "no NumPy for " << STRATA_TEST_PYTHON;
  TempFolder folder;
  SampleColumns s = RandomSamples(257, 23);
  s.triangle[3] = ~std::uint64_t{0};
  const auto size =
      WriteSamples(folder / "a.npz", SampleFormat::kNpz, s, HeaderFor(s, kAllAttributes));
  ASSERT_TRUE(size) << MessageOf(size);
  const Output output = RunPython(folder, kScript, folder / "a.npz");
  ASSERT_EQ(output.status, 0) << output.text;
  std::string expected;
  expected += "area <f8 257\n" + Bits<std::uint64_t>(s.area) + "\n";
  expected += "barycentric <f8 257 3\n" + Bits<std::uint64_t>(s.barycentric) + "\n";
  expected += "cell <i4 257 3\n" + Bits<std::uint32_t>(s.cell) + "\n";
  expected += "normal <f4 257 3\n" + Bits<std::uint32_t>(s.normal) + "\n";
  expected += "position <f8 257 3\n" + Bits<std::uint64_t>(s.position) + "\n";
  expected += "provenance U\n" + Hex(test::kProvenance) + "\n";
  expected += "triangle <u8 257\n" + Bits<std::uint64_t>(s.triangle) + "\n";
  expected += "weight <f8 257\n" + Bits<std::uint64_t>(s.weight) + "\n";
  EXPECT_EQ(output.text, expected);
}

TEST(NpzWriter, LeavesOutWhatWasNotAskedFor) {
  if (!HaveNumpy()) GTEST_SKIP() << "no NumPy for " << STRATA_TEST_PYTHON;
  TempFolder folder;
  const SampleColumns s = RandomSamples(1, 23);
  ASSERT_TRUE(WriteSamples(folder / "a.npz", SampleFormat::kNpz, s, HeaderFor(s, 0)));
  const Output output = RunPython(
      folder, "import sys, numpy\nprint(*sorted(numpy.load(sys.argv[1]).files))", folder / "a.npz");
  EXPECT_EQ(output.text, "position provenance\n");
}

TEST(NpzWriter, ProvenanceThatIsNotUtf8IsMarkedAndNotLost) {
  if (!HaveNumpy()) GTEST_SKIP() << "no NumPy for " << STRATA_TEST_PYTHON;
  TempFolder folder;
  const SampleColumns s = RandomSamples(1, 23);
  SampleHeader header = HeaderFor(s, 0);
  header.provenance = "a\xff\xe2\x82\xac\xf0\x9f\x98\x80\xe2\x82z\xc0\x80\xed\xa0\x80";
  ASSERT_TRUE(WriteSamples(folder / "a.npz", SampleFormat::kNpz, s, header));
  const Output output = RunPython(
      folder, "import sys, numpy\nprint(ascii(str(numpy.load(sys.argv[1])['provenance'])))",
      folder / "a.npz");
  EXPECT_EQ(output.text,
            "'a\\ufffd\\u20ac\\U0001f600\\ufffd\\ufffdz\\ufffd\\ufffd\\ufffd\\ufffd\\ufffd'\n");
}

TEST(NpzWriter, ArraysBeyond4GiBAreRead) {
  if (getenv("STRATA_LARGE_FILES") == nullptr) {
    GTEST_SKIP() << "writes 9 GB; set STRATA_LARGE_FILES to run it";
  }
  if (!HaveNumpy()) GTEST_SKIP() << "no NumPy for " << STRATA_TEST_PYTHON;
  TempFolder folder;
  const SampleColumns part = RandomSamples(1'000'000, 23);
  SampleHeader header = HeaderFor(part, kArea);
  header.count = 180 * part.size();
  auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch) << MessageOf(scratch);
  auto writer =
      OpenSampleWriter(folder / "a.npz", SampleFormat::kNpz, header, {.scratch = scratch->get()});
  ASSERT_TRUE(writer) << MessageOf(writer);
  for (int k = 0; k < 180; ++k) ASSERT_TRUE((*writer)->Write(part));
  const auto size = (*writer)->Finish();
  ASSERT_TRUE(size) << MessageOf(size);
  EXPECT_GT(*size, std::uint64_t{180'000'000} * 32);
  // Whole archives would take their size in memory: the ends of the arrays tell enough.
  const Output output = RunPython(folder, R"(
import sys, zipfile
import numpy as np
z = zipfile.ZipFile(sys.argv[1])
for name, row in (('position.npy', 24), ('area.npy', 8)):
    with z.open(name) as f:
        np.lib.format.read_magic(f)
        print(*np.lib.format.read_array_header_1_0(f)[0])
        f.seek(z.getinfo(name).file_size - row)
        print(*np.frombuffer(f.read(), '<u8'))
)",
                                  folder / "a.npz");
  EXPECT_EQ(output.text, "180000000 3\n" + Bits<std::uint64_t>(std::vector{part.position.back()}) +
                             "\n180000000\n" + Bits<std::uint64_t>(std::vector{part.area.back()}) +
                             "\n");
}

}  // namespace
}  // namespace strata::io
