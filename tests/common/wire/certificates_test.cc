#include "common/wire/certificates.h"

#include <openssl/crypto.h>
#include <unistd.h>

#include <cstdlib>
#include <functional>
#include <string>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_certificates.h"

namespace craftfleet::wire {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class CertificatesTest : public testing::Test {
 protected:
  std::string Pem(const std::string& name) const { return folder_ / (name + ".pem"); }
  std::string Key(const std::string& name) const { return folder_ / (name + ".key"); }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
};

TEST_F(CertificatesTest, KeyAndCertificateMustMatch) {
  ca_.Issue("a", {"a"});
  ca_.Issue("b", {"b"});
  EXPECT_THAT(CheckKeyPair(Pem("a"), Key("a")), IsOk());
  EXPECT_THAT(CheckKeyPair(Pem("a"), Key("b")),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "--tls_key=" + Key("b") + " is not the key of --tls_cert=" + Pem("a")));
  EXPECT_THAT(CheckKeyPair(Key("a"), Key("a")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_cert=" + Key("a") + ": no certificate")));
  EXPECT_THAT(CheckKeyPair(Pem("a"), Pem("a")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_key=" + Pem("a") + ": no private key")));
  EXPECT_THAT(CheckKeyPair(Pem("away"), Key("a")),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--tls_cert: cannot open " + Pem("away"))));
  EXPECT_THAT(CheckKeyPair(Pem("a"), Key("away")),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--tls_key: cannot open " + Key("away"))));
}

TEST_F(CertificatesTest, AuthoritiesMustBeCertificates) {
  EXPECT_THAT(CheckAuthorities(Pem("ca")), IsOk());
  ca_.Issue("a", {"a"});
  EXPECT_THAT(CheckAuthorities(Key("a")), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--tls_ca=")));
  EXPECT_THAT(CheckAuthorities(Pem("away")),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("--tls_ca: cannot open " + Pem("away"))));
}

TEST_F(CertificatesTest, ExplainsWhyPeersMayRefuseACertificate) {
  TestAuthority other(folder_, "other");
  ca_.Issue("good", {"good"});
  ca_.Issue("old", {"old", 1, true, -7200, -3600});
  ca_.Issue("young", {"young", 1, true, 3600, 7200});
  EXPECT_EQ(CertificateProblem(Pem("good"), Pem("ca"), absl::Now()), "");
  EXPECT_THAT(CertificateProblem(Pem("old"), Pem("ca"), absl::Now()),
              HasSubstr("--tls_cert=" + Pem("old") + " expired on 20"));
  EXPECT_THAT(CertificateProblem(Pem("young"), Pem("ca"), absl::Now()), HasSubstr("is not valid before 20"));
  EXPECT_THAT(CertificateProblem(Pem("good"), Pem("other"), absl::Now()),
              AllOf(HasSubstr("not from an authority"), HasSubstr("--tls_ca=" + Pem("other"))));
}

// The standard's example: FIPS 180-2, "abc".
TEST(Sha256, MatchesTheExampleOfFips180) {
  EXPECT_EQ(Sha256Hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

// Ends a process whose first use of OpenSSL is in `use`, and checks that it can be used until the last handler of
// exit() has run. Actors crashed at their end if a thread of gRPC was in a handshake meanwhile.
void ExpectOpenSslToOutlive(const std::function<void()>& use) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");  // a new process
  EXPECT_EXIT(
      {
        std::atexit([] { _exit(OPENSSL_init_crypto(0, nullptr) == 1 ? 0 : 1); });  // the first handler is called last
        use();
        std::exit(2);
      },
      testing::ExitedWithCode(0), "");
}

TEST(OpenSsl, OutlivesTheHandlersOfExitAfterAConnection) {
  ExpectOpenSslToOutlive([] {
    Connect("127.0.0.1:1");
    OPENSSL_init_crypto(OPENSSL_INIT_LOAD_CRYPTO_STRINGS, nullptr);  // as gRPC does for its first handshake
  });
}

TEST(OpenSsl, OutlivesTheHandlersOfExitAfterACheckOfFiles) {
  ExpectOpenSslToOutlive([] { CheckAuthorities("ca.pem", "no certificate").IgnoreError(); });
}

}  // namespace
}  // namespace craftfleet::wire
