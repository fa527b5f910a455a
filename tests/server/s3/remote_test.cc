// Names, settings and journals of buckets, without a store.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <string>

#include "server/remote/s3_client.h"
#include "server/remote/s3_config.h"
#include "server/remote/s3_name.h"
#include "server/remote/s3_xml.h"
#include "server/remote/upload_journal.h"
#include "tests/support/process.h"

namespace strata::server {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

using Variables = std::map<std::string, std::string>;

Result<S3Config> Load(Variables variables, bool allow_http = false) {
  variables.try_emplace("HOME", "/nonexistent");
  return LoadS3Config(
      [variables](const char* name) {
        const auto found = variables.find(name);
        return found != variables.end() ? found->second.c_str() : nullptr;
      },
      allow_http);
}

Variables Keys(const Variables& more = {}) {
  Variables variables{{"AWS_ACCESS_KEY_ID", "ID"}, {"AWS_SECRET_ACCESS_KEY", "SECRET"}};
  variables.insert(more.begin(), more.end());
  return variables;
}

std::string MessageOf(const Result<S3Config>& config) {
  return config ? "no error" : config.error().message;
}

TEST(S3Url, NamesBucketAndKey) {
  const auto name = ParseS3Url("s3://bucket/a/b c%20.ply");
  ASSERT_TRUE(name) << name.error().message;
  EXPECT_EQ(name->bucket, "bucket");
  EXPECT_EQ(name->key, "a/b c%20.ply");
  EXPECT_EQ(ParseS3Url("s3://bucket")->key, "");
  EXPECT_EQ(ParseS3Url("s3://bucket/")->key, "");
}

TEST(S3Url, IsRefusedWithoutAValidBucket) {
  for (const char* const url :
       {"", "bucket/a", "S3://bucket", "s3:/bucket", "s3://", "s3:///a", "s3://ab", "s3://a..b",
        "s3://user@host", "s3://host:80/a", "s3://-ab", "s3://a b c", "s3://bucket?x"}) {
    EXPECT_FALSE(ParseS3Url(url)) << url;
  }
  EXPECT_FALSE(ParseS3Url("s3://bucket/" + std::string(1025, 'x')));
}

TEST(S3Name, IsShownWithoutControlCharacters) {
  EXPECT_EQ((S3Name{"b", "a\n\x1b[2J"}.Shown()), "s3://b/a%0A%1B[2J");
  EXPECT_EQ((S3Name{"b", "ü\x7f"}.Shown()), "s3://b/ü%7F");
  EXPECT_EQ((S3Name{"b", "\xff"}.Shown()), "s3://b/%FF");
}

TEST(KeyAsPath, IsRefusedWhenItCouldLeaveItsFolder) {
  for (const std::string& key :
       {std::string(), std::string(".."), std::string("../a"), std::string("a/../b"),
        std::string("/a"), std::string("a//b"), std::string("a/"), std::string("a/."),
        std::string("a\\..\\b"), std::string("a\0b", 3), std::string("\xff\xfe"),
        "a/" + std::string(256, 'x')}) {
    EXPECT_NE(WhyNotAPath(key), "") << testing::PrintToString(key);
  }
  EXPECT_EQ(WhyNotAPath("a/b c/ü..ply"), "");
}

TEST(Query, IsSortedByItsEncodedNames) {
  EXPECT_EQ(EncodeQuery({{"uploads", ""}, {"prefix", "a b/+"}, {"encoding-type", "url"}}),
            "encoding-type=url&prefix=a%20b%2F%2B&uploads=");
}

TEST(PercentCoding, IsUndone) {
  std::string all;
  for (int c = 0; c < 256; ++c) all += static_cast<char>(c);
  EXPECT_EQ(*PercentDecode(PercentEncode(all, false)), all);
  EXPECT_EQ(*PercentDecode("a+b%2B"), "a b+");
  for (const char* const text : {"%", "%4", "%zz", "a%4"}) EXPECT_FALSE(PercentDecode(text));
}

TEST(S3Settings, AreTakenFromTheEnvironment) {
  const auto config = Load(Keys({{"AWS_SESSION_TOKEN", "TOKEN"},
                                 {"AWS_DEFAULT_REGION", "eu-central-1"},
                                 {"AWS_REGION", "eu-west-3"},
                                 {"AWS_MAX_ATTEMPTS", "3"}}));
  ASSERT_TRUE(config) << MessageOf(config);
  EXPECT_EQ(config->access_key, "ID");
  EXPECT_EQ(config->secret_key, "SECRET");
  EXPECT_EQ(config->session_token, "TOKEN");
  EXPECT_EQ(config->region, "eu-west-3");
  EXPECT_EQ(config->endpoint, "");
  EXPECT_TRUE(config->virtual_hosts);
  EXPECT_EQ(config->max_attempts, 3);
}

TEST(S3Settings, PutTheBucketIntoThePathOfAnEndpointOfOnesOwn) {
  const auto config = Load(Keys({{"AWS_ENDPOINT_URL", "https://all.example"},
                                 {"AWS_ENDPOINT_URL_S3", "https://store.example:9000/"}}));
  ASSERT_TRUE(config) << MessageOf(config);
  EXPECT_EQ(config->endpoint, "https://store.example:9000");
  EXPECT_FALSE(config->virtual_hosts);
}

TEST(S3Settings, AreIncompleteWithoutBothKeys) {
  EXPECT_THAT(MessageOf(Load({})), HasSubstr("no credentials"));
  EXPECT_THAT(MessageOf(Load({{"AWS_ACCESS_KEY_ID", "ID"}})), HasSubstr("one is set"));
}

TEST(S3Settings, AllowPlainHttpToThisMachineAlone) {
  for (const char* const mine : {"http://127.0.0.1:1", "http://localhost", "http://[::1]:9000"}) {
    EXPECT_TRUE(Load(Keys({{"AWS_ENDPOINT_URL", mine}}))) << mine;
  }
  for (const char* const others :
       {"http://store.example", "http://127.0.0.1.store.example", "http://localhost.store.example",
        "http://127.1", "http://[::2]", "ftp://127.0.0.1", "http://user@127.0.0.1",
        "http://127.0.0.1@store.example", "http://127.0.0.1/path", "http://", "127.0.0.1"}) {
    EXPECT_FALSE(Load(Keys({{"AWS_ENDPOINT_URL", others}}))) << others;
  }
  EXPECT_TRUE(Load(Keys({{"AWS_ENDPOINT_URL", "http://store.example"}}), true));
}

TEST(S3Settings, NeverShowASecretInAMessage) {
  for (const Variables& wrong :
       {Variables{{"AWS_SECRET_ACCESS_KEY", "SEC RET\n"}}, Variables{{"AWS_REGION", "UP"}},
        Variables{{"AWS_MAX_ATTEMPTS", "0"}}, Variables{{"AWS_ENDPOINT_URL", "nowhere"}}}) {
    Variables variables = wrong;
    variables.merge(Keys());
    const auto config = Load(variables);
    ASSERT_FALSE(config);
    EXPECT_EQ(config.error().code, ErrorCode::kInvalidArgument);
    EXPECT_THAT(config.error().message, Not(HasSubstr("SEC")));
  }
}

TEST(S3Settings, NameWhatAProfileWantsAndStrataDoesNotDo) {
  const test::ScratchFolder folder;
  test::WriteFile(folder / "config", "[profile work]\nrole_arn = arn:aws:iam::1:role/x\n");
  const auto config = Load({{"AWS_CONFIG_FILE", folder / "config"}, {"AWS_PROFILE", "work"}});
  EXPECT_THAT(MessageOf(config), HasSubstr("'work' gets its credentials by role_arn"));
}

TEST(S3Parts, GrowSoThatTenThousandSuffice) {
  constexpr std::uint64_t kMiB = 1 << 20;
  EXPECT_EQ(S3Client::PartBytes(1), 8 * kMiB);
  EXPECT_EQ(S3Client::PartBytes(80'000 * kMiB), 8 * kMiB);
  EXPECT_EQ(S3Client::PartBytes(80'000 * kMiB + 1), 16 * kMiB);
  EXPECT_LE(S3Client::PartBytes(std::uint64_t{5} << 40), std::uint64_t{5} << 30);
}

TEST(S3Answers, KeepBlanksInKeys) {
  const auto page = ParseObjectPage(
      "<ListBucketResult><Contents><Key> </Key><Size>7</Size><ETag>&quot;t&quot;</ETag></Contents>"
      "<Contents><Key>&#x61;&amp;\xC3\xBC </Key><Size>8</Size></Contents></ListBucketResult>");
  ASSERT_TRUE(page) << page.error().message;
  ASSERT_EQ(page->objects.size(), 2u);
  EXPECT_EQ(page->objects[0].key, " ");
  EXPECT_EQ(page->objects[0].etag, "t");
  EXPECT_EQ(page->objects[1].key, "a&ü ");
}

TEST(S3Answers, AreRefusedCutOffAnywhere) {
  const std::string whole =
      "<ListBucketResult><IsTruncated>false</IsTruncated><Contents><Key>a</Key><Size>7</Size>"
      "</Contents></ListBucketResult>";
  ASSERT_TRUE(ParseObjectPage(whole));
  for (std::size_t size = 0; size < whole.size(); ++size) {
    EXPECT_FALSE(ParseObjectPage(std::string_view(whole).substr(0, size))) << size;
  }
}

TEST(UploadJournal, KnowsWhatWasBegunAndNotEnded) {
  const test::ScratchFolder folder;
  const std::string path = folder / "uploads";
  {
    const auto journal = UploadJournal::Open(path);
    ASSERT_TRUE(journal) << journal.error().message;
    ASSERT_TRUE((*journal)->Began({"bucket", "a b\n/ü"}, "id/1+"));
    ASSERT_TRUE((*journal)->Began({"bucket", "c"}, "id2"));
    (*journal)->Ended({"bucket", "c"}, "id2");
    EXPECT_THAT((*journal)->leftovers(), testing::IsEmpty());
  }
  std::ofstream(path, std::ios::app) << "begin bucket torn";
  const auto next = UploadJournal::Open(path);
  ASSERT_TRUE(next) << next.error().message;
  ASSERT_EQ((*next)->leftovers().size(), 1u);
  EXPECT_EQ((*next)->leftovers()[0].name.key, "a b\n/ü");
  EXPECT_EQ((*next)->leftovers()[0].id, "id/1+");
  ASSERT_TRUE((*next)->Began({"bucket", "d"}, "id3"));
  const auto last = UploadJournal::Open(path);
  ASSERT_TRUE(last) << last.error().message;
  ASSERT_EQ((*last)->leftovers().size(), 2u) << "a line after a part of one is a line of its own";
  EXPECT_EQ((*last)->leftovers()[1].name.key, "d");
}

}  // namespace
}  // namespace strata::server
