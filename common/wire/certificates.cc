#include "common/wire/certificates.h"

#include <openssl/bio.h>
#include <openssl/crypto.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/sha.h>
#include <openssl/x509.h>

#include <ctime>
#include <memory>
#include <mutex>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"

namespace craftfleet::wire {
namespace {

struct Free {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
};
using BioPtr = std::unique_ptr<BIO, Free>;
using CertificatePtr = std::unique_ptr<X509, Free>;
using KeyPtr = std::unique_ptr<EVP_PKEY, Free>;

// Keeps OpenSSL from asking for a password on the terminal.
int NoPassword(char* /*buffer*/, int /*size*/, int /*writing*/, void* /*data*/) { return -1; }

// All certificates in `pem`, the contents of file `path`; at least one.
absl::StatusOr<std::vector<CertificatePtr>> ParseCertificates(absl::string_view flag, const std::string& path,
                                                              absl::string_view pem) {
  KeepOpenSslUp();
  const BioPtr bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  std::vector<CertificatePtr> certificates;
  while (X509* certificate = PEM_read_bio_X509(bio.get(), nullptr, NoPassword, nullptr)) {
    certificates.emplace_back(certificate);
  }
  ERR_clear_error();
  if (certificates.empty()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--%s=%s: no certificate in it, want PEM (-----BEGIN CERTIFICATE-----)", flag, path));
  }
  return certificates;
}

absl::StatusOr<std::vector<CertificatePtr>> ReadCertificates(absl::string_view flag, const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string pem, WithPrefix(absl::StrCat("--", flag), ReadFile(path)));
  return ParseCertificates(flag, path, pem);
}

std::string Date(const ASN1_TIME* time) {
  std::tm parts = {};
  if (ASN1_TIME_to_tm(time, &parts) != 1) return "an unreadable date";
  return absl::FormatTime("%Y-%m-%d %H:%M UTC", absl::FromTM(parts, absl::UTCTimeZone()), absl::UTCTimeZone());
}

}  // namespace

void KeepOpenSslUp() {
  static std::once_flag once;
  std::call_once(once, [] { OPENSSL_init_crypto(OPENSSL_INIT_NO_ATEXIT, nullptr); });
}

absl::Status CheckKeyPair(const std::string& certificate, const std::string& key) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string certificate_pem, WithPrefix("--tls_cert", ReadFile(certificate)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string key_pem, WithPrefix("--tls_key", ReadFile(key)));
  return CheckKeyPair(certificate, certificate_pem, key, key_pem);
}

absl::Status CheckKeyPair(const std::string& certificate, absl::string_view certificate_pem, const std::string& key,
                          absl::string_view key_pem) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<CertificatePtr> chain,
                              ParseCertificates("tls_cert", certificate, certificate_pem));
  const BioPtr bio(BIO_new_mem_buf(key_pem.data(), static_cast<int>(key_pem.size())));
  const KeyPtr private_key(PEM_read_bio_PrivateKey(bio.get(), nullptr, NoPassword, nullptr));
  const bool fits = private_key != nullptr && X509_check_private_key(chain.front().get(), private_key.get()) == 1;
  ERR_clear_error();
  if (private_key == nullptr) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "--tls_key=%s: no private key in it, want PEM without a password (-----BEGIN PRIVATE KEY-----)", key));
  }
  if (!fits) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--tls_key=%s is not the key of --tls_cert=%s", key, certificate));
  }
  return absl::OkStatus();
}

absl::Status CheckAuthorities(const std::string& authorities) {
  return ReadCertificates("tls_ca", authorities).status();
}

absl::Status CheckAuthorities(const std::string& authorities, absl::string_view pem) {
  return ParseCertificates("tls_ca", authorities, pem).status();
}

std::string CertificateProblem(const std::string& certificate, const std::string& authorities, absl::Time now) {
  const absl::StatusOr<std::vector<CertificatePtr>> chain = ReadCertificates("tls_cert", certificate);
  if (!chain.ok()) return std::string(chain.status().message());
  X509* leaf = chain->front().get();
  time_t seconds = absl::ToTimeT(now);
  if (X509_cmp_time(X509_get0_notAfter(leaf), &seconds) < 0) {
    return absl::StrFormat("--tls_cert=%s expired on %s", certificate, Date(X509_get0_notAfter(leaf)));
  }
  if (X509_cmp_time(X509_get0_notBefore(leaf), &seconds) > 0) {
    return absl::StrFormat("--tls_cert=%s is not valid before %s, and this host's clock says %s: set the clock",
                           certificate, Date(X509_get0_notBefore(leaf)),
                           absl::FormatTime("%Y-%m-%d %H:%M UTC", now, absl::UTCTimeZone()));
  }
  // A chain may lead to an authority through intermediate certificates; only a single certificate can be checked here.
  if (authorities.empty() || chain->size() > 1) return "";
  const absl::StatusOr<std::vector<CertificatePtr>> known = ReadCertificates("tls_ca", authorities);
  if (!known.ok()) return std::string(known.status().message());
  for (const CertificatePtr& authority : *known) {
    const bool signed_by = X509_verify(leaf, X509_get0_pubkey(authority.get())) == 1;
    ERR_clear_error();
    if (signed_by) return "";
  }
  return absl::StrFormat("--tls_cert=%s is not from an authority in --tls_ca=%s", certificate, authorities);
}

std::string Sha256Hex(absl::string_view text) {
  KeepOpenSslUp();
  unsigned char digest[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const unsigned char*>(text.data()), text.size(), digest);
  return absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(digest), sizeof(digest)));
}

}  // namespace craftfleet::wire
