// Checks of certificate files before anything connects.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

namespace craftfleet::wire {

// Keeps OpenSSL usable until the process ends. By default exit() tears it down, while threads of gRPC, which is not
// shut down (KeepGrpcUp), may still be in a handshake: they then wrote to freed memory. To be called before OpenSSL's
// first use, as the functions below and KeepGrpcUp do. Thread-safe.
void KeepOpenSslUp();

// OK if `certificate` is a PEM file with a certificate and `key` one with its private key. Dates are not checked.
//   InvalidArgument: it is not.   Others: a file can't be read.   All name flag and file.
absl::Status CheckKeyPair(const std::string& certificate, const std::string& key);

// OK if `authorities` is a PEM file with at least one certificate. Errors as above.
absl::Status CheckAuthorities(const std::string& authorities);

// The same for contents that were read from these files.
absl::Status CheckKeyPair(const std::string& certificate, absl::string_view certificate_pem, const std::string& key,
                          absl::string_view key_pem);
absl::Status CheckAuthorities(const std::string& authorities, absl::string_view pem);

// Why peers may refuse the first certificate of file `certificate` at time `now`: a clause such as "--tls_cert=a.pem
// expired on 2026-01-31 12:00 UTC", or that no authority in `authorities` signed it (not checked if empty). Empty: no
// reason is known.
std::string CertificateProblem(const std::string& certificate, const std::string& authorities, absl::Time now);

// SHA-256 of `text`, 64 lower-case hexadecimal digits.
std::string Sha256Hex(absl::string_view text);

}  // namespace craftfleet::wire
