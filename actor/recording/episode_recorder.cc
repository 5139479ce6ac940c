#include "actor/recording/episode_recorder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/recording/npz.h"
#include "actor/recording/picture.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

absl::StatusOr<AttentionLight> LightOf(const EpisodeRecorder::AttentionSource& source,
                                       const EpisodeRecorder::Options& options, absl::string_view frame) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionMap map, source(frame));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> weights, Choose(map, *options.attention));
  return LightToHighest(map.patches, weights);
}

template <typename T>
void AppendBytes(const T& value, std::string* bytes) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Rewards are multiples of 0.1, which the float32 of the protocol does not hold exactly.
double InTenths(float reward) { return std::round(double{reward} * 10) / 10; }

}  // namespace

// One episode as rows, for a NumPy file in the format of Crafter's own episode recorder. The first row is the reset:
// its image, and zeros. Each further row is a step: action, reward, and the game after it.
// Source: what crafter/recorder.py of the Python package writes (version 1.8.3).
class EpisodeRecorder::Table {
 public:
  // `frame_size`: pixels, width and height of the images.
  Table(int frame_size, const Moment& first)
      : frame_size_(frame_size), images_(first.frame), semantics_(kWorldSize * kWorldSize, '\0'), rows_(1) {}

  void Add(const ObservedStep& step, const Moment& moment) {
    images_ += moment.frame;
    semantics_ += moment.semantic;
    Row& row = rows_.emplace_back();
    row.action = step.action;
    row.reward = InTenths(step.reward);
    row.done = step.end != StepEnd::kNone;
    row.discount = step.end == StepEnd::kTerminated ? 0 : 1;
    row.player_pos = {moment.player_x, moment.player_y};
    row.achievements = moment.achievements;
    row.inventory = moment.inventory;
  }

  // With T the number of steps: image uint8[T+1,H,W,3], action int64[T+1], reward float64, done bool, discount float64
  // (0 at a death, else 1), semantic uint8[T+1,64,64], player_pos int64[T+1,2], achievement_<name> int64 (so far in the
  // episode), ainventory_<item> int64.
  std::vector<NpyArray> Arrays() const {
    const auto rows = static_cast<int64_t>(rows_.size());
    std::vector<NpyArray> arrays;
    arrays.push_back({"image", "|u1", {rows, frame_size_, frame_size_, 3}, images_});
    // Appends `value(row)` of each row to the bytes of a column.
    const auto add = [&](std::string name, const char* dtype, std::vector<int64_t> shape, auto value) {
      NpyArray& array = arrays.emplace_back();
      array.name = std::move(name);
      array.dtype = dtype;
      array.shape = std::move(shape);
      for (const Row& row : rows_) AppendBytes(value(row), &array.data);
    };
    add("action", "<i8", {rows}, [](const Row& row) { return static_cast<int64_t>(row.action); });
    add("reward", "<f8", {rows}, [](const Row& row) { return row.reward; });
    add("done", "|b1", {rows}, [](const Row& row) { return row.done; });
    add("discount", "<f8", {rows}, [](const Row& row) { return row.discount; });
    arrays.push_back({"semantic", "|u1", {rows, kWorldSize, kWorldSize}, semantics_});
    add("player_pos", "<i8", {rows, 2}, [](const Row& row) { return row.player_pos; });
    for (int i = 0; i < kNumAchievements; ++i) {
      add(absl::StrCat("achievement_", kAchievementNames[i]), "<i8", {rows},
          [i](const Row& row) { return int64_t{row.achievements[i]}; });
    }
    for (int i = 0; i < kNumItems; ++i) {
      add(absl::StrCat("ainventory_", kItemNames[i]), "<i8", {rows},
          [i](const Row& row) { return int64_t{row.inventory[i]}; });
    }
    return arrays;
  }

 private:
  struct Row {
    Action action = Action::kNoop;
    double reward = 0;
    bool done = false;
    double discount = 0;
    std::array<int64_t, 2> player_pos{};
    AchievementCounts achievements{};
    std::array<int32_t, kNumItems> inventory{};
  };

  const int frame_size_;
  std::string images_;     // uint8[rows,H,W,3]
  std::string semantics_;  // uint8[rows,64,64]
  std::vector<Row> rows_;
};

EpisodeRecorder::EpisodeRecorder(const Options& options, AttentionSource attention, absl::Time start)
    : options_(options), attention_(std::move(attention)), start_(start) {}

EpisodeRecorder::~EpisodeRecorder() = default;

absl::StatusOr<std::unique_ptr<EpisodeRecorder>> EpisodeRecorder::Create(const Options& options,
                                                                         AttentionSource attention, absl::Time start) {
  if (options.attention.has_value()) {
    const std::string black(size_t{3} * options.frame_size * options.frame_size, '\0');
    CRAFTFLEET_RETURN_IF_ERROR(LightOf(attention, options, black).status());
  }
  for (const std::string& folder : {options.video_folder, options.npz_folder, options.picture_folder}) {
    if (!folder.empty()) CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  }
  return std::unique_ptr<EpisodeRecorder>(new EpisodeRecorder(options, std::move(attention), start));
}

absl::Status EpisodeRecorder::OnStart(int64_t number, const Moment& moment) {
  Recording recording;
  if (!options_.video_folder.empty()) {
    const std::string path = JoinPath(options_.video_folder, absl::StrCat("episode ", number));
    CRAFTFLEET_ASSIGN_OR_RETURN(recording.video, VideoFile::Create(path, picture_width(), picture_height()));
  }
  if (!options_.npz_folder.empty()) recording.table = std::make_unique<Table>(options_.frame_size, moment);
  CRAFTFLEET_RETURN_IF_ERROR(AddPicture(number, moment, &recording));
  recordings_.insert_or_assign(number, std::move(recording));
  return absl::OkStatus();
}

absl::Status EpisodeRecorder::OnStep(int64_t number, const ObservedStep& step, const Moment& moment) {
  Recording& recording = recordings_.at(number);
  ++recording.steps;
  recording.unlocked = CountUnlocked(moment.achievements);
  if (recording.table != nullptr) recording.table->Add(step, moment);
  CRAFTFLEET_RETURN_IF_ERROR(AddPicture(number, moment, &recording));
  if (step.end == StepEnd::kNone) return absl::OkStatus();
  return Finish(number);
}

absl::Status EpisodeRecorder::FinishAll() {
  while (!recordings_.empty()) CRAFTFLEET_RETURN_IF_ERROR(Finish(recordings_.begin()->first));
  return absl::OkStatus();
}

absl::StatusOr<std::string> EpisodeRecorder::Show(const Moment& moment) const {
  if (!options_.attention.has_value()) return moment.picture;
  CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionLight light, LightOf(attention_, options_, moment.frame));
  const int size = options_.picture_size;
  const std::string overlay = OverlayAttention(moment.picture, size, light.brightness, options_.frame_size);
  return BesideOverlay(moment.picture, overlay, size, light);
}

absl::Status EpisodeRecorder::AddPicture(int64_t number, const Moment& moment, Recording* recording) {
  const bool still = !options_.picture_folder.empty() && recording->steps % options_.picture_every == 0;
  if (!still && recording->video == nullptr) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string picture, Show(moment));
  if (still) {
    const std::string name = absl::StrFormat("episode-%04d-step-%05d.png", number, recording->steps);
    CRAFTFLEET_RETURN_IF_ERROR(
        WritePng(JoinPath(options_.picture_folder, name), picture, picture_width(), picture_height()));
  }
  return recording->video == nullptr ? absl::OkStatus() : recording->video->Append(picture);
}

absl::Status EpisodeRecorder::Finish(int64_t number) {
  const Recording recording = std::move(recordings_.at(number));
  recordings_.erase(number);  // first: an error must not make FinishAll write it again
  const std::string stem = Stem(number, recording);
  if (recording.table != nullptr) {
    const std::string path = JoinPath(options_.npz_folder, absl::StrCat(stem, ".npz"));
    CRAFTFLEET_RETURN_IF_ERROR(WriteNpz(path, recording.table->Arrays()));
  }
  if (recording.video == nullptr) return absl::OkStatus();
  return recording.video->Finish(JoinPath(options_.video_folder, absl::StrCat(stem, ".mp4")));
}

std::string EpisodeRecorder::Stem(int64_t number, const Recording& recording) const {
  const auto taken = [](const std::string& folder, const std::string& name) {
    return !folder.empty() && PathExists(JoinPath(folder, name));
  };
  for (absl::Time time = start_ + absl::Seconds(number - options_.first_episode);; time += absl::Seconds(1)) {
    std::string stem =
        absl::StrFormat("%s-episode%04d-ach%d-len%d", absl::FormatTime("%Y%m%dT%H%M%S", time, absl::UTCTimeZone()),
                        number, recording.unlocked, recording.steps);
    if (!taken(options_.npz_folder, stem + ".npz") && !taken(options_.video_folder, stem + ".mp4")) return stem;
  }
}

}  // namespace craftfleet
