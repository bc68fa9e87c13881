{error}
@message = internal constant [{length} x i8] c"{message}\00"
@{name}.type = global i64 0
@{name}.info = constant {{ i64, ptr, ptr }} {{ i64 24, ptr null, ptr @{name}.release }}
define ptr @{name}.find(i64 %number) {{
entry:
  %table = inttoptr i64 {table} to ptr
  br label %probe
probe:
  %step = phi i64 [ 0, %entry ], [ %next, %further ]
  %shifted = add i64 %number, %step
  %place = and i64 %shifted, {mask}
  %row = getelementptr {{ i64, i64, i64 }}, ptr %table, i64 %place
  %pair = cmpxchg ptr %row, i64 0, i64 %number seq_cst seq_cst, align 8
  %found = extractvalue {{ i64, i1 }} %pair, 0
  %is_new = extractvalue {{ i64, i1 }} %pair, 1
  %is_own = icmp eq i64 %found, %number
  %hit = or i1 %is_new, %is_own
  br i1 %hit, label %done, label %further
further:
  %next = add i64 %step, 1
  %full = icmp ugt i64 %next, {mask}
  br i1 %full, label %done, label %probe
done:
  %result = phi ptr [ %row, %probe ], [ null, %further ]
  ret ptr %result
}}
define internal ptr @row_of_frame(ptr %frame) {{
entry:
  %attributes_place = getelementptr i8, ptr %frame, i64 160
  %attributes = load ptr, ptr %attributes_place
  %scalar = load ptr, ptr %attributes
  %number_place = getelementptr i8, ptr %scalar, i64 8
  %number_pointer = load ptr, ptr %number_place
  %number = load i64, ptr %number_pointer
  %row = call ptr @{name}.find(i64 %number)
  ret ptr %row
}}
define internal void @describe(ptr %extension, i64 %type) {{
entry:
  %metadata_place = getelementptr i8, ptr %extension, i64 24
  %metadata = load ptr, ptr %metadata_place
  %major = getelementptr i8, ptr %metadata, i64 24
  store i32 {major}, ptr %major
  %minor = getelementptr i8, ptr %metadata, i64 28
  store i32 {minor}, ptr %minor
  %traits = getelementptr i8, ptr %metadata, i64 32
  store i32 0, ptr %traits
  %state = getelementptr i8, ptr %metadata, i64 40
  store i64 %type, ptr %state
  ret void
}}
define ptr @{name}(ptr %frame) {{
entry:
  %extension_place = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_place
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %look, label %describe
describe:
  call void @describe(ptr %extension, i64 0)
  ret ptr null
look:
  %row = call ptr @row_of_frame(ptr %frame)
  %full = icmp eq ptr %row, null
  br i1 %full, label %missing, label %load
load:
  %address_place = getelementptr i64, ptr %row, i64 1
  %address = load atomic i64, ptr %address_place acquire, align 8
  %there = icmp ne i64 %address, 0
  br i1 %there, label %call, label %missing
call:
  %kernel = inttoptr i64 %address to ptr
  %error = call ptr %kernel(ptr %frame)
  ret ptr %error
missing:
  %made = call ptr @error(ptr %frame, ptr @message)
  ret ptr %made
}}
define ptr @{name}.instantiate(ptr %frame) {{
entry:
  %given = alloca {{ i64, ptr, ptr, i32, ptr, ptr }}
  %extension_place = getelementptr i8, ptr %frame, i64 8
  %extension = load ptr, ptr %extension_place
  %plain = icmp eq ptr %extension, null
  br i1 %plain, label %look, label %describe
describe:
  %type = load i64, ptr @{name}.type
  call void @describe(ptr %extension, i64 %type)
  ret ptr null
look:
  %row = call ptr @row_of_frame(ptr %frame)
  %full = icmp eq ptr %row, null
  br i1 %full, label %missing, label %count
count:
  %executables = getelementptr i64, ptr %row, i64 2
  %before = atomicrmw add ptr %executables, i64 1 seq_cst
  %context_place = getelementptr i8, ptr %frame, i64 24
  %context = load ptr, ptr %context_place
  %stage_place = getelementptr i8, ptr %frame, i64 32
  %stage = load i32, ptr %stage_place
  %with_context = insertvalue {{ i64, ptr, ptr, i32, ptr, ptr }}
    {{ i64 48, ptr null, ptr null, i32 0, ptr @{name}.type, ptr null }}, ptr %context, 2
  %with_stage = insertvalue {{ i64, ptr, ptr, i32, ptr, ptr }} %with_context, i32 %stage, 3
  %filled = insertvalue {{ i64, ptr, ptr, i32, ptr, ptr }} %with_stage, ptr %row, 5
  store {{ i64, ptr, ptr, i32, ptr, ptr }} %filled, ptr %given
  %interface_place = getelementptr i8, ptr %frame, i64 16
  %interface = load ptr, ptr %interface_place
  %set_place = getelementptr i8, ptr %interface, i64 104
  %set = load ptr, ptr %set_place
  %error = call ptr %set(ptr %given)
  ret ptr %error
missing:
  %made = call ptr @error(ptr %frame, ptr @message)
  ret ptr %made
}}
define void @{name}.release(ptr %row) {{
entry:
  %executables = getelementptr i64, ptr %row, i64 2
  %before = atomicrmw sub ptr %executables, i64 1 seq_cst
  ret void
}}
define void @{name}.remove(ptr %row, i64 %address) {{
entry:
  %address_place = getelementptr i64, ptr %row, i64 1
  %pair = cmpxchg ptr %address_place, i64 %address, i64 0 seq_cst seq_cst, align 8
  ret void
}}
