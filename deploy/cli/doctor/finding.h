// The result of a check of craftfleet doctor.

#ifndef CRAFTFLEET_DEPLOY_CLI_DOCTOR_FINDING_H_
#define CRAFTFLEET_DEPLOY_CLI_DOCTOR_FINDING_H_

#include <string>

namespace craftfleet {

enum class Verdict {
  kOk,
  kWarn,  // works, but slower or less safely than possible
  kFail,  // something will not work
};

struct Finding {
  std::string check;  // its name, "open files"
  Verdict verdict = Verdict::kOk;
  std::string found;   // one line
  std::string remedy;  // what to do; empty with kOk
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_DOCTOR_FINDING_H_
