#include "learner/training/records/training_view.h"

#include <utility>

namespace craftfleet {

void TrainingView::OnStart(const RunFolder& folder, int64_t env_steps) { Publish(folder, env_steps, 0, ""); }

void TrainingView::OnIterationEnd(const RunFolder& folder, int64_t env_steps, double steps_per_second,
                                  const Fragment& shown, int frame_size) {
  speed_.Add({env_steps, steps_per_second});
  const size_t bytes = shown.frames.size();
  const size_t frame_bytes = size_t{3} * frame_size * frame_size;
  Publish(folder, env_steps, frame_size, bytes < frame_bytes ? "" : shown.frames.substr(bytes - frame_bytes));
}

void TrainingView::Publish(const RunFolder& folder, int64_t env_steps, int frame_size, std::string frame) {
  auto moment = std::make_shared<Moment>();
  moment->env_steps = env_steps;
  moment->episodes = folder.score().episodes();
  moment->curve = folder.curve().Points();
  moment->speed = speed_.Points();
  moment->rates = folder.score().SuccessPercentages();
  moment->frame_size = frame_size;
  moment->frame = std::move(frame);
  const MutexLock lock(&mu_);
  moment->number = now_->number + 1;
  now_ = std::move(moment);
}

std::shared_ptr<const TrainingView::Moment> TrainingView::Now() const {
  const MutexLock lock(&mu_);
  return now_;
}

}  // namespace craftfleet
