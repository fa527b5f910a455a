// Columns that came from the mesh, as files hold them: right types, integers exact, names kept.
#include "io/carried_columns.h"

#include <gtest/gtest.h>
#include <stdio.h>

#include <cstdlib>
#include <cstring>
#include <sstream>
#include <string>
#include <vector>

#include "io/sample_writer.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/mesh_attribute.h"
#include "tests/support/read_draco.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::MakeAttribute;
using test::MessageOf;
using test::TempFolder;

struct Carried {
  SampleColumns samples;
  SampleHeader header;
};

// Samples with a column of every type; `most` bounds the 64-bit integers.
Carried Samples(std::size_t n, std::uint64_t most) {
  Carried c;
  c.samples = test::RandomSamples(n, 4);
  c.header = test::HeaderFor(c.samples, kNormal | kWeight);
  auto& columns = c.header.carried;
  columns = {MakeAttribute("color", ScalarType::kUint8, 3, Semantic::kColor),
             MakeAttribute("uv", ScalarType::kFloat32, 2, Semantic::kUv),
             MakeAttribute("small", ScalarType::kInt8, 1),
             MakeAttribute("short", ScalarType::kInt16, 2),
             MakeAttribute("code", ScalarType::kUint16, 1),
             MakeAttribute("near", ScalarType::kInt32, 1),
             MakeAttribute("far", ScalarType::kInt32, 1),
             MakeAttribute("hash", ScalarType::kUint32, 1),
             MakeAttribute("id", ScalarType::kInt64, 1),
             MakeAttribute("key", ScalarType::kUint64, 2),
             MakeAttribute("wide", ScalarType::kFloat64, 15),
             MakeAttribute("group", ScalarType::kUint32, 1, Semantic::kGroup)};
  columns[0].normalized = true;
  columns[0].color_space = ColorSpace::kSrgb;
  columns[11].names = {"oak", "say \"ash\"", "Käfer"};
  test::TestRandom random(8);
  for (const MeshAttribute& column : columns) {
    std::vector<char>& bytes = c.samples.carried.emplace_back(n * column.bytes());
    for (char& b : bytes) b = static_cast<char>(random.Bits());
    const std::size_t numbers = n * static_cast<std::size_t>(column.components);
    for (std::size_t i = 0; i < numbers; ++i) {
      char* const at = bytes.data() + i * SizeOf(column.type);
      if (column.type == ScalarType::kFloat32) {
        const float v = static_cast<float>(random.In(-9, 9));
        std::memcpy(at, &v, sizeof v);
      } else if (column.type == ScalarType::kFloat64) {
        const double v = random.In(-9, 9);
        std::memcpy(at, &v, sizeof v);
      } else if (SizeOf(column.type) == 8) {
        const std::uint64_t v = random.Bits() % most;
        std::memcpy(at, &v, sizeof v);
      } else if (column.name == "group" || column.name == "near") {
        const std::uint32_t v = static_cast<std::uint32_t>(random.Below(3));
        std::memcpy(at, &v, sizeof v);
      }
    }
  }
  return c;
}

SampleColumns Part(const Carried& c, std::size_t first, std::size_t n) {
  SampleColumns part = test::Slice(c.samples, first, n);
  for (std::size_t k = 0; k < c.header.carried.size(); ++k) {
    const std::size_t bytes = c.header.carried[k].bytes();
    const char* const from = c.samples.carried[k].data() + first * bytes;
    part.carried.emplace_back(from, from + n * bytes);
  }
  return part;
}

Result<std::string> Write(const TempFolder& folder, SampleFormat format, const Carried& c) {
  const std::string path = folder / "out";
  auto writer = OpenSampleWriter(path, format, c.header);
  if (!writer) return Forward(writer);
  for (std::size_t i = 0; i < c.samples.size(); i += 7) {
    const std::size_t n = std::min<std::size_t>(7, c.samples.size() - i);
    if (auto ok = (*writer)->Write(Part(c, i, n)); !ok) return Forward(ok);
  }
  if (auto done = (*writer)->Finish(); !done) return Forward(done);
  return test::ReadFile(path);
}

TEST(CarriedColumns, OfAPlyAreProperties) {
  const TempFolder folder;
  const Carried c = Samples(20, std::uint64_t{1} << 53);
  const auto file = Write(folder, SampleFormat::kPly, c);
  ASSERT_TRUE(file) << MessageOf(file);
  const std::size_t end = file->find("end_header\n") + 11;
  const std::string head = file->substr(0, end);
  for (const char* const line :
       {"\ncomment column "
        "{\"name\":\"color\",\"type\":\"uint8\",\"components\":3,\"semantic\":\"color\","
        "\"color_space\":\"srgb\",\"normalized\":true}\n",
        "\ncomment name group 1 \"say \\\"ash\\\"\"\n",
        "\nproperty double weight\nproperty uchar red\n",
        "\nproperty uchar blue\nproperty float s\nproperty float t\nproperty char small\n",
        "\nproperty short short_0\nproperty short short_1\nproperty ushort code\n",
        "\nproperty uint hash\nproperty double id\nproperty double key_0\n",
        "\nproperty double wide_14\nproperty uint group\nend_header\n"}) {
    EXPECT_NE(head.find(line), std::string::npos) << line << head;
  }
  // A row: position, normal, weight, and then the columns one after the other.
  std::size_t row = 24 + 12 + 8, at_id = 0;
  for (const MeshAttribute& column : c.header.carried) {
    if (column.name == "id") at_id = row;
    row += column.bytes();
  }
  ASSERT_EQ(file->size(), end + 20 * row);
  for (std::size_t i = 0; i < 20; ++i) {
    std::size_t at = end + i * row + 44;
    for (std::size_t k = 0; k < 8; ++k) {
      const std::size_t bytes = c.header.carried[k].bytes();
      EXPECT_EQ(std::memcmp(file->data() + at, &c.samples.carried[k][i * bytes], bytes), 0);
      at += bytes;
    }
    double id;
    std::int64_t expected;
    std::memcpy(&id, file->data() + end + i * row + at_id, sizeof id);
    std::memcpy(&expected, &c.samples.carried[8][i * 8], sizeof expected);
    EXPECT_EQ(static_cast<std::int64_t>(id), expected);
  }
}

TEST(CarriedColumns, OfAPlyAreRefusedWhereADoubleWouldRoundThem) {
  const TempFolder folder;
  const auto file = Write(folder, SampleFormat::kPly, Samples(20, ~std::uint64_t{0}));
  ASSERT_FALSE(file);
  EXPECT_EQ(file.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(file.error().message.find("a value of 'id', "), std::string::npos)
      << file.error().message;
  EXPECT_TRUE(folder.List().empty());
}

TEST(CarriedColumns, OfTextReadBackAsTheSameNumbers) {
  const TempFolder folder;
  const Carried c = Samples(20, ~std::uint64_t{0});
  for (const SampleFormat format : {SampleFormat::kXyz, SampleFormat::kCsv}) {
    const auto file = Write(folder, format, c);
    ASSERT_TRUE(file) << MessageOf(file);
    std::string text = *file;
    const bool csv = format == SampleFormat::kCsv;
    EXPECT_EQ(text.find('#') == std::string::npos, csv);
    EXPECT_EQ(text.rfind("# x y z nx ny nz weight red green blue s t small", 0) == 0, false);
    EXPECT_NE(text.find(csv ? "x,y,z,nx,ny,nz,weight,red,green,blue,s,t,small,short_0"
                            : "\n# x y z nx ny nz weight red green blue s t small short_0"),
              std::string::npos);
    for (char& ch : text) ch = ch == ',' && csv ? ' ' : ch;
    std::istringstream lines(text);
    std::string line;
    for (int skip = csv ? 1 : 4; skip > 0; --skip) std::getline(lines, line);
    for (std::size_t i = 0; i < 20; ++i) {
      std::getline(lines, line);
      std::istringstream row(line);
      std::string word;
      for (int fixed = 0; fixed < 7; ++fixed) row >> word;
      for (int color = 0; color < 3; ++color) {
        row >> word;
        EXPECT_EQ(std::stoi(word), static_cast<std::uint8_t>(c.samples.carried[0][3 * i + color]));
      }
      for (int skip = 0; skip < 2 + 1 + 2 + 1 + 1 + 1 + 1 + 1; ++skip) row >> word;
      for (int key = 0; key < 2; ++key) {
        std::uint64_t expected;
        std::memcpy(&expected, &c.samples.carried[9][16 * i + 8 * key], sizeof expected);
        row >> word;
        EXPECT_EQ(std::stoull(word), expected);
      }
    }
  }
}

TEST(CarriedColumns, OfADracoHaveTheirTypesAndValuesToTheBit) {
  const TempFolder folder;
  const Carried c = Samples(500, ~std::uint64_t{0});
  const auto file = Write(folder, SampleFormat::kDraco, c);
  ASSERT_TRUE(file) << MessageOf(file);
  const auto cloud = test::DecodeDraco(*file);
  ASSERT_NE(cloud, nullptr);
  const draco::DataType types[] = {draco::DT_UINT8,  draco::DT_FLOAT32, draco::DT_INT8,
                                   draco::DT_INT16,  draco::DT_UINT16,  draco::DT_INT32,
                                   draco::DT_INT32,  draco::DT_UINT32,  draco::DT_INT64,
                                   draco::DT_UINT64, draco::DT_FLOAT64, draco::DT_UINT32};
  for (std::size_t k = 0; k < c.header.carried.size(); ++k) {
    const MeshAttribute& column = c.header.carried[k];
    const int id = cloud->GetAttributeIdByMetadataEntry("name", column.name);
    ASSERT_GE(id, 0) << column.name;
    const draco::PointAttribute& attribute = *cloud->attribute(id);
    EXPECT_EQ(attribute.data_type(), types[k]) << column.name;
    EXPECT_EQ(attribute.num_components(), column.components);
    EXPECT_EQ(attribute.normalized(), column.normalized);
    std::vector<char> value(column.bytes());
    for (draco::PointIndex i(0); i < cloud->num_points(); ++i) {
      attribute.GetMappedValue(i, value.data());
      ASSERT_EQ(
          std::memcmp(value.data(), &c.samples.carried[k][i.value() * value.size()], value.size()),
          0)
          << column.name << " of " << i.value();
    }
    std::string json;
    EXPECT_TRUE(cloud->GetAttributeMetadataByAttributeId(id)->GetEntryString("column", &json));
    EXPECT_EQ(json, ColumnJson(column));
    EXPECT_EQ(cloud->GetAttributeMetadataByAttributeId(id)->GetEntryString("names", &json),
              column.name == "group");
    if (column.name == "group") {
      EXPECT_EQ(json, NamesJson(column));
    }
  }
  EXPECT_EQ(cloud->GetNamedAttributeId(draco::GeometryAttribute::COLOR),
            cloud->GetAttributeIdByMetadataEntry("name", "color"));
  EXPECT_EQ(cloud->GetNamedAttributeId(draco::GeometryAttribute::TEX_COORD),
            cloud->GetAttributeIdByMetadataEntry("name", "uv"));
}

const char* const kScript = R"(
import sys, json
import numpy as np
z = np.load(sys.argv[1], allow_pickle=False)
for column in json.loads(str(z['columns'])):
    a = z[column['name']]
    print(column['name'], a.dtype.name, *a.shape, a.tobytes().hex())
print('|'.join(z['group_names'][z['group']][:3]))
)";

TEST(CarriedColumns, OfAnNpzAreWhatNumPyReads) {
  if (system((std::string(STRATA_TEST_PYTHON) + " -c 'import numpy' >/dev/null 2>&1").c_str())) {
    GTEST_SKIP() << "no NumPy";
  }
  const TempFolder folder;
  const Carried c = Samples(30, ~std::uint64_t{0});
  const auto file = Write(folder, SampleFormat::kNpz, c);
  ASSERT_TRUE(file) << MessageOf(file);
  test::WriteFile(folder / "read.py", kScript);
  const std::string command = std::string(STRATA_TEST_PYTHON) + " '" + (folder / "read.py") +
                              "' '" + (folder / "out") + "' 2>&1";
  FILE* const pipe = popen(command.c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  std::string found;
  char part[4096];
  while (const std::size_t n = fread(part, 1, sizeof part, pipe)) found.append(part, n);
  EXPECT_EQ(pclose(pipe), 0) << found;
  std::string expected;
  for (std::size_t k = 0; k < c.header.carried.size(); ++k) {
    const MeshAttribute& column = c.header.carried[k];
    expected += column.name + " " + NameOf(column.type) + " 30";
    if (column.components > 1) expected += " " + std::to_string(column.components);
    expected += " ";
    for (const char b : c.samples.carried[k]) {
      char hex[3];
      std::snprintf(hex, sizeof hex, "%02x", static_cast<unsigned>(static_cast<std::uint8_t>(b)));
      expected += hex;
    }
    expected += "\n";
  }
  for (std::size_t i = 0; i < 3; ++i) {
    std::uint32_t group;
    std::memcpy(&group, &c.samples.carried[11][4 * i], sizeof group);
    expected += (i > 0 ? "|" : "") + c.header.carried[11].names[group];
  }
  EXPECT_EQ(found, expected + "\n");
}

TEST(CarriedColumns, MustHaveAValueForEachSample) {
  const TempFolder folder;
  Carried c = Samples(20, 9);
  auto writer = OpenSampleWriter(folder / "out", SampleFormat::kPly, c.header);
  ASSERT_TRUE(writer);
  SampleColumns part = Part(c, 0, 20);
  part.carried[3].pop_back();
  const auto written = (*writer)->Write(part);
  ASSERT_FALSE(written);
  EXPECT_NE(written.error().message.find("'short' does not have one value"), std::string::npos);
}

TEST(ComponentNames, AreUnique) {
  const std::vector<MeshAttribute> columns = {
      MakeAttribute("red", ScalarType::kInt32, 1),
      MakeAttribute("color", ScalarType::kUint8, 3, Semantic::kColor),
      MakeAttribute("texture", ScalarType::kUint8, 4, Semantic::kColor),
      MakeAttribute("v", ScalarType::kFloat32, 2)};
  const std::vector<std::vector<std::string>> expected = {
      {"red"},
      {"red_2", "green", "blue"},
      {"texture_red", "texture_green", "texture_blue", "texture_alpha"},
      {"v_0", "v_1"}};
  EXPECT_EQ(ComponentNames(columns), expected);
}

TEST(ComponentNames, OfATextureAreThoseThatViewersLookForUnlessAColourHasThem) {
  const MeshAttribute color = MakeAttribute("color", ScalarType::kFloat32, 3, Semantic::kColor);
  const MeshAttribute texture = MakeAttribute("texture", ScalarType::kUint8, 4, Semantic::kTexture);
  const std::vector<std::string> plain = {"red", "green", "blue", "alpha"};
  EXPECT_EQ(ComponentNames(std::vector{texture})[0], plain);
  const std::vector<std::string> behind = {"texture_red", "texture_green", "texture_blue",
                                           "texture_alpha"};
  EXPECT_EQ(ComponentNames(std::vector{color, texture})[1], behind);
}

}  // namespace
}  // namespace strata::io
