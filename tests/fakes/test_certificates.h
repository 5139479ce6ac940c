// Certificates that are created while a test runs; the repository contains none.

#pragma once

#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509v3.h>

#include <cstdio>
#include <memory>
#include <string>
#include <utility>

#include "common/base/check.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {

struct CertificateOptions {
  std::string name;  // common name and DNS name
  int64_t serial = 1;
  bool local = true;            // also valid for localhost and 127.0.0.1
  int64_t starts_in_s = -3600;  // seconds from now
  int64_t ends_in_s = 3600;
};

// A certificate authority. Writes its own certificate to NAME.pem in the folder, and issued ones with their keys.
class TestAuthority {
 public:
  TestAuthority(const TempFolder& folder, const std::string& name) : folder_(folder) {
    certificate_ = Make({name, 1}, nullptr, nullptr, &key_);
    Write(name + ".pem", [this](FILE* file) { return PEM_write_X509(file, certificate_.get()); });
  }

  // Issues a certificate and writes FILE.pem and FILE.key. Existing files are replaced by renames, the key first.
  void Issue(const std::string& file, const CertificateOptions& options) {
    Key key;
    const Certificate certificate = Make(options, certificate_.get(), key_.get(), &key);
    Write(file + ".key",
          [&key](FILE* out) { return PEM_write_PrivateKey(out, key.get(), nullptr, nullptr, 0, nullptr, nullptr); });
    Write(file + ".pem", [&certificate](FILE* out) { return PEM_write_X509(out, certificate.get()); });
  }

 private:
  struct Free {
    void operator()(X509* certificate) const { X509_free(certificate); }
    void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  };
  using Certificate = std::unique_ptr<X509, Free>;
  using Key = std::unique_ptr<EVP_PKEY, Free>;

  // Signed by `issuer`; by itself if that is null.
  static Certificate Make(const CertificateOptions& options, X509* issuer, EVP_PKEY* issuer_key, Key* key) {
    key->reset(EVP_EC_gen("P-256"));
    CRAFTFLEET_CHECK(*key != nullptr);
    Certificate certificate(X509_new());
    X509* x509 = certificate.get();
    X509_set_version(x509, 2);
    ASN1_INTEGER_set_int64(X509_get_serialNumber(x509), options.serial);
    X509_gmtime_adj(X509_getm_notBefore(x509), options.starts_in_s);
    X509_gmtime_adj(X509_getm_notAfter(x509), options.ends_in_s);
    X509_set_pubkey(x509, key->get());
    X509_NAME_add_entry_by_txt(X509_get_subject_name(x509), "CN", MBSTRING_ASC,
                               reinterpret_cast<const unsigned char*>(options.name.c_str()), -1, -1, 0);
    X509_set_issuer_name(x509, X509_get_subject_name(issuer == nullptr ? x509 : issuer));
    const std::string names = "DNS:" + options.name + (options.local ? ",DNS:localhost,IP:127.0.0.1" : "");
    Extend(x509, NID_subject_alt_name, names);
    Extend(x509, NID_basic_constraints, issuer == nullptr ? "critical,CA:TRUE" : "CA:FALSE");
    CRAFTFLEET_CHECK(X509_sign(x509, issuer == nullptr ? key->get() : issuer_key, EVP_sha256()) > 0);
    return certificate;
  }

  static void Extend(X509* certificate, int kind, const std::string& value) {
    X509_EXTENSION* extension = X509V3_EXT_conf_nid(nullptr, nullptr, kind, value.c_str());
    CRAFTFLEET_CHECK(extension != nullptr);
    X509_add_ext(certificate, extension, -1);
    X509_EXTENSION_free(extension);
  }

  template <typename Writer>
  void Write(const std::string& name, const Writer& writer) {
    const std::string path = folder_ / name;
    FILE* file = std::fopen((path + ".new").c_str(), "w");
    CRAFTFLEET_CHECK(file != nullptr && writer(file) == 1 && std::fclose(file) == 0);
    CRAFTFLEET_CHECK(std::rename((path + ".new").c_str(), path.c_str()) == 0);
  }

  const TempFolder& folder_;
  Key key_;
  Certificate certificate_;
};

}  // namespace craftfleet
