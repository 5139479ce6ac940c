// A learner's journal of fragments: every fragment read has the run's shape, and one appended later is found again. The
// first byte selects whether the rest is the whole file, or one record with a correct checksum after a valid start, so
// that the search gets past the checksum.

#include "common/base/check.h"
#include "common/base/crc32c.h"
#include "common/base/little_endian.h"
#include "common/io/files.h"
#include "learner/training/fragments/fragment_journal.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_folder.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

constexpr char kRunId[] = "run-a";

std::string Path() { return JoinPath(FuzzFolder(), "fragments.journal"); }

FragmentJournal Open() { return FragmentJournal(Path(), kRunId); }

std::string Record(absl::string_view bytes) {
  std::string record;
  AppendLittleEndian(static_cast<uint32_t>(bytes.size()), &record);
  AppendLittleEndian(Crc32c(bytes), &record);
  record.append(bytes.data(), bytes.size());
  return record;
}

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view rest = input.substr(1);
  const bool whole_file = (input[0] & 1) == 0;
  CRAFTFLEET_CHECK(WriteFileSynced(Path(), whole_file ? std::string(rest) : Record(kRunId) + Record(rest)).ok());
  FragmentJournal journal = Open();
  const std::vector<Fragment> fragments = journal.Read(kSampleShape);
  for (const Fragment& fragment : fragments) {
    CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < kSampleShape.lanes);
    CRAFTFLEET_CHECK(static_cast<int>(fragment.frames.size()) == kSampleShape.steps * kSampleShape.frame_bytes);
  }
  CRAFTFLEET_CHECK(journal.Append(SampleFragment(1, 4, 7)).ok());
  const std::vector<Fragment> again = Open().Read(kSampleShape);
  CRAFTFLEET_CHECK(again.size() == fragments.size() + 1 && again.back().number == 4);
}

std::vector<std::string> SoundInputs() {
  const std::string fragment = wire::ToProto(SampleFragment(2, 5, 7)).SerializeAsString();
  return {'\0' + Record(kRunId) + Record(fragment) + Record(fragment), '\1' + fragment, '\0' + Record("run-b")};
}

}  // namespace craftfleet
