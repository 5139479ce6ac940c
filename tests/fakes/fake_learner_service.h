// A learner whose answers to fragments are scripted by the test.

#pragma once

#include <cstddef>
#include <deque>
#include <string>
#include <utility>
#include <vector>

#include "common/base/mutex.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// Thread-safe.
class FakeLearnerService : public v1::LearnerService::Service {
 public:
  enum class Answer {
    kAccept,
    kDuplicate,
    kExpire,
    kBreak,         // end the stream without a verdict
    kRefuse,        // with a reason
    kBadVerdict,    // one that does not exist
    kWrongVerdict,  // on another fragment
    kUnasked,       // a reply to a request for permits instead
    kSilence,       // no answer until the client ends the stream
  };

  // Sets the answers to the next fragments, in order of arrival; later ones are accepted.
  void Script(const std::vector<Answer>& answers) {
    const MutexLock lock(&mu_);
    answers_.assign(answers.begin(), answers.end());
  }
  // The chunks that GetWeights sends.
  void SetWeights(const std::vector<v1::WeightsChunk>& chunks) {
    const MutexLock lock(&mu_);
    chunks_ = chunks;
  }
  std::vector<v1::FragmentMessage> received() const {
    const MutexLock lock(&mu_);
    return received_;
  }

  // Answers no request for permits from now on; the others get an empty reply.
  void IgnoreRequests() {
    const MutexLock lock(&mu_);
    ignores_requests_ = true;
  }
  // Reads so many messages in all, and no more until ResumeReading.
  void PauseReadingAfter(size_t messages) {
    const MutexLock lock(&mu_);
    most_ = messages;
  }
  void ResumeReading() {
    const MutexLock lock(&mu_);
    most_ = std::string::npos;
    changed_.NotifyAll();
  }
  // Ends the stream before the next read, even while reading pauses.
  void EndStream() {
    const MutexLock lock(&mu_);
    ends_stream_ = true;
    changed_.NotifyAll();
  }
  // What came, in order: 'p' for a request for permits, 'f' for a fragment.
  std::string order() const {
    const MutexLock lock(&mu_);
    return order_;
  }

  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::LearnerMessage, v1::ActorMessage>* stream) override {
    v1::ActorMessage message;
    while (Read(stream, &message)) {
      v1::LearnerMessage answer;
      if (message.has_permits()) {
        answer.mutable_permits();
        if (!ignores_requests()) stream->Write(answer);
        continue;
      }
      const v1::FragmentMessage& fragment = message.fragment();
      v1::FragmentVerdict& verdict = *answer.mutable_verdict();
      verdict.set_lane(fragment.lane());
      verdict.set_number(fragment.number());
      verdict.set_verdict(v1::FragmentVerdict::ACCEPTED);
      switch (Take(fragment)) {
        case Answer::kAccept:
          break;
        case Answer::kDuplicate:
          verdict.set_verdict(v1::FragmentVerdict::DUPLICATE);
          break;
        case Answer::kExpire:
          verdict.set_verdict(v1::FragmentVerdict::EXPIRED);
          break;
        case Answer::kBreak:
          return {grpc::StatusCode::UNAVAILABLE, "broken off"};
        case Answer::kRefuse:
          verdict.set_verdict(v1::FragmentVerdict::REFUSED);
          verdict.set_reason("frames: 1 bytes, want 2");
          break;
        case Answer::kBadVerdict:
          verdict.set_verdict(static_cast<v1::FragmentVerdict::Verdict>(17));
          break;
        case Answer::kWrongVerdict:
          verdict.set_number(fragment.number() + 1);
          break;
        case Answer::kUnasked:
          answer.mutable_permits();
          break;
        case Answer::kSilence:
          continue;
      }
      stream->Write(answer);
    }
    return grpc::Status::OK;
  }

  grpc::Status GetWeights(grpc::ServerContext* /*context*/, const v1::WeightsRequest* /*request*/,
                          grpc::ServerWriter<v1::WeightsChunk>* writer) override {
    std::vector<v1::WeightsChunk> chunks;
    {
      const MutexLock lock(&mu_);
      chunks = chunks_;
    }
    for (const v1::WeightsChunk& chunk : chunks) writer->Write(chunk);
    return grpc::Status::OK;
  }

 private:
  bool Read(grpc::ServerReaderWriter<v1::LearnerMessage, v1::ActorMessage>* stream, v1::ActorMessage* message) {
    {
      const MutexLock lock(&mu_);
      changed_.Wait(&mu_,
                    [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return order_.size() < most_ || ends_stream_; });
      if (std::exchange(ends_stream_, false)) return false;
    }
    if (!stream->Read(message)) return false;
    const MutexLock lock(&mu_);
    order_ += message->has_permits() ? 'p' : 'f';
    return true;
  }
  bool ignores_requests() const {
    const MutexLock lock(&mu_);
    return ignores_requests_;
  }
  Answer Take(const v1::FragmentMessage& message) {
    const MutexLock lock(&mu_);
    received_.push_back(message);
    if (answers_.empty()) return Answer::kAccept;
    const Answer answer = answers_.front();
    answers_.pop_front();
    return answer;
  }

  mutable Mutex mu_;
  CondVar changed_;
  bool ignores_requests_ ABSL_GUARDED_BY(mu_) = false;
  size_t most_ ABSL_GUARDED_BY(mu_) = std::string::npos;  // messages to read
  bool ends_stream_ ABSL_GUARDED_BY(mu_) = false;
  std::string order_ ABSL_GUARDED_BY(mu_);
  std::deque<Answer> answers_ ABSL_GUARDED_BY(mu_);
  std::vector<v1::FragmentMessage> received_ ABSL_GUARDED_BY(mu_);
  std::vector<v1::WeightsChunk> chunks_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet
